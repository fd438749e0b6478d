"""Pages for a browser or a notebook: replay, comparison of two runs, report, playground.

Each page is one file with a template beside it. Look at a page in a browser after a change.
"""
