"""From the text of a graph file to checked data."""

from dmframe.config.experiment import Experiment, load_experiment

__all__ = ["Experiment", "load_experiment"]
