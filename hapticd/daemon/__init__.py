"""The process: servo, commands, telemetry, flight recorder."""
