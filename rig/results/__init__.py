"""Results of the commands: turns the record of a result into terminal text, JSON, HTML and
figures.
"""
