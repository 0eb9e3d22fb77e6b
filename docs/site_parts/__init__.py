"""What `docs/make_site.py` and `docs/conf.py` are made of; all but `extension` work without Sphinx."""
