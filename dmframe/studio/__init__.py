"""Studio: a local web page to edit one graph file, with diagram, verdict and live page next to the text.

A server on 127.0.0.1 (`dmframe.studio.server`) has the file (`dmframe.studio.file`) and a worker process
(`dmframe.studio.worker`) with all modules loaded, which forks for each text and examines it (`dmframe.studio.examine`).
"""
