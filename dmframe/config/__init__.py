"""From the text of a graph file to checked data."""
