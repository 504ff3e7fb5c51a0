"""Publication of scenes as a folder that a data hub takes, and the reader of such folders."""
