"""Console: a page in the browser that shows runs and sends commands to them, and the process that
serves the page.

The process is separate from the processes of the runs. The console reads run folders, and exchanges
messages with a run only through the control socket of that run.
"""
