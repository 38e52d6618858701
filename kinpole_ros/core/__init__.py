"""The compiled library of the package: C that needs no headers of Python, and its bindings."""
