"""The taps of a recording: found, fitted one by one, and the law of all."""
