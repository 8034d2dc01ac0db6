"""The computations of the stage analyse: one function for each kind of work item, from inputs to tables."""
