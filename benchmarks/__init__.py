"""The engines against their peers."""
