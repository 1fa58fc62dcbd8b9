"""Recordings of surfaces from .csv, .npz and .wav files: conversion to SI units on one uniform clock, and faults.

files     the bytes of a recording's file, and its columns as numbers
clock     quantities and their units; columns on a uniform clock, with jitter and gaps of their times corrected
clipping  clipped samples
spans     the spans in which a mask of samples is true
sensor    response of a sensor's mounting and filter to a decaying sinusoid
"""
