"""The report of a study: figures, films and one page. Plain data in, text and bytes out; no store here.

To add a figure: write a function in the module of its subject, under its heading, section and caption.
"""
