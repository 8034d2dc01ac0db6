"""The workflow: the contract of a stage, the graph of a study, the dispatcher and its progress."""
