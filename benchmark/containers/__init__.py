"""Methods in containers: a program reads a folder of photographs and writes poses."""
