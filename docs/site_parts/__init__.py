"""Modules of `docs/make_site.py` and `docs/conf.py`; all but `extension` work without Sphinx."""
