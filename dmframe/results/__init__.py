"""Results of a run: metrics, labelled data, figures, results folder."""

from dmframe.results.folder import write_run
from dmframe.results.metrics import TrackingError, TurnError, tracking_error, turn_error
from dmframe.results.place import reserved
from dmframe.results.run import Run
from dmframe.results.summary import summary

__all__ = ["Run", "TrackingError", "TurnError", "reserved", "summary", "tracking_error", "turn_error", "write_run"]
