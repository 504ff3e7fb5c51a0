"""The object-connect network: its name is reserved here, its parts are not built yet."""
