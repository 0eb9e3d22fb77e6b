"""Results of a run: metrics, labelled data, figures, results folder."""
