"""What an operator sees in a browser: a page that watches runs and commands one of them.

A process of its own. It reads run folders, and speaks to a run only through the run's control
socket.
"""
