"""What a run leaves behind: metrics, labelled data, a folder of results, figures."""

from dmframe.results.folder import Result, reserve, reserved, write_run
from dmframe.results.metrics import TrackingError, tracking_error
from dmframe.results.summary import summary

__all__ = ["Result", "TrackingError", "reserve", "reserved", "summary", "tracking_error", "write_run"]
