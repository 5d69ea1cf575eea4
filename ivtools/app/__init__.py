"""The local web app: one's own log, from the file to the diagnosis, in one window.

A small server on 127.0.0.1 keeps the files and the state, a process of its own does the work, and
the pages are those of `ivtools.report` with charts that ask for the samples that are visible.

Why not Panel with HoloViews and Bokeh, which also re-sample on the server: they bring 812 MB (45
packages, with datashader, most of it numba and scipy again; panel, bokeh, holoviews, xarray and
datashader alone 217 MB), a second plotting library beside the one of the pages, and a socket that
carries the state of every widget. starlette and uvicorn are 3 MB; the charts, the tables, the
words and the dark mode are those of the pages that one downloads, because they are the same code;
and a chart of 10^6 samples zooms in a fraction of 200 ms (`tests/test_app_browser.py` measures it).

Files come from strangers. They are read by the same readers as on the command line, in a process
that ends with its work; nothing in them is executed, and their names are shown, never used.
"""
