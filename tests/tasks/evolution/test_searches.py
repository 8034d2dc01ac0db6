"""Every search: cut anywhere a trial is the same, its best is never lost, and its history tells everything."""
