"""The report of a study: figures, films and one page. Plain data in, text and bytes out; no store here.

To add a figure: draw it in the module of its subject, list it in figures.py, and give it a place in page.html.
"""
