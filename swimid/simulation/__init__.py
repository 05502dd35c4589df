"""Any parameter file on any robot: simulated runs, and measured trials against their simulation."""
