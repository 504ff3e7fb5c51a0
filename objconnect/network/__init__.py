"""The object-connect network: features that depend on objects, for direct alignment.

Equations are numbered as in the object-connect paper, see ``docs/objconnect.md``.
"""
