"""Graphs: the objects that a program changes, runs, proves, analyses, draws and compares."""
