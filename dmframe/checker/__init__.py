"""Checkers of certificates, each one file without any import of this framework: `check.py` and `check.js`."""
