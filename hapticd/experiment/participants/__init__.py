"""Simulated participants: a hand that explores surfaces, and an observer that answers from the samples that it felt.

hand       waypoints of taps, strokes and presses, as varied as a person's
observer   features of the felt force, and answers
simulated  a front (user interface) of a session, made of hand and observer
"""
