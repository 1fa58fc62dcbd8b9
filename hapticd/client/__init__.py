"""Clients of a daemon: blocking and asyncio, samples, recordings, the live view."""
