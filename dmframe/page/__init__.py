"""A closed loop as one file for a browser: it runs there, under sliders, with what is proved of it beside it."""

from dmframe.page.page import Page

__all__ = ["Page"]
