"""Simulated participants: a hand that explores surfaces, and an observer that answers from the samples that it felt.

hand       waypoints of taps, strokes and presses, as varied as those of a person
observer   features of the felt force, and answers
simulated  the front (user interface) of a session, with a hand and an observer
"""
