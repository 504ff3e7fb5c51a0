"""Publication of scenes as a folder for a data hub, and the reader of such folders."""
