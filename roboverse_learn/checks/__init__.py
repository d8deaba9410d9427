"""What a task, a policy and a robot promise, as small functions that the tests and a user's command share.

``roboverse check`` runs them on one thing and prints a table; ``tests/contracts`` runs those of tasks over
everything that is registered. A contract is a function with a name, a line that says what it shows, and a
sentence that tells the author what to mend.
"""
