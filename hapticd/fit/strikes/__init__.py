"""Strikes of grooves: found, fitted stroke by stroke, and numbered along the surface."""
