"""Recordings: their three formats written and read, and rendered again."""
