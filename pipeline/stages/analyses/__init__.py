"""What the stage analyse computes: one function a kind of item, from its job and inputs to tables and reasons."""
