"""The object-connect network: features that depend on objects, for direct alignment.

Numbers of equations are those of the object-connect paper, see ``docs/objconnect.md``.
"""
