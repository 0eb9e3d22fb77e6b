"""Reports on a graph: certificate, assumptions, simulated run and linear analysis as HTML, Markdown, JSON or text."""
