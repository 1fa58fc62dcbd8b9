"""Simulated participants: a hand that explores, and a rule that judges from what that hand felt.

hand       where the hand goes: taps, strokes and presses as varied as a person's
observer   what is felt, and what is answered
simulated  the front that both make together
"""
