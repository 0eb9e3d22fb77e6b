"""Live page: the closed loop simulated in a browser, with parameter sliders and its verdict."""

from dmframe.page.page import Page, page_of
from dmframe.page.periods import stable_periods
from dmframe.page.rivals import ghosts_of

__all__ = ["Page", "ghosts_of", "page_of", "stable_periods"]
