"""What is found out by measuring: configurations checked, devices calibrated, recordings of surfaces read."""
