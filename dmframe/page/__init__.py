"""Live page: the closed loop simulated in a browser, with parameter sliders and its verdict."""

from dmframe.page.page import Page

__all__ = ["Page"]
