"""Reading of graph files: from YAML text to validated data."""

from dmframe.config.experiment import Experiment, load_experiment

__all__ = ["Experiment", "load_experiment"]
