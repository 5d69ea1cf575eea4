"""The local web app: one's own log, from the file to the diagnosis, in one window.

A small server on 127.0.0.1 keeps the files and the state, a process of its own does the work, and
the pages are those of `ivtools.report` with charts that ask for the samples that are visible.

Why not Panel with HoloViews and Bokeh, which also re-sample on the server: they bring 41 packages
(panel, bokeh, holoviews, xarray and datashader alone are 217 MB), a second plotting library beside
that of the pages, and a socket that carries the state of every widget. starlette and uvicorn are 7
packages and 5 MB, and the charts, tables, words and colours of the window are those of the page
that is taken away, because the same code makes both. How long a zoom takes at 10^6 samples is in
benchmarks/results/app.md.

Files come from strangers. They are read by the same readers as on the command line, in a process
that can be ended at any time; nothing in them is executed, and their names are shown, never used.
"""
