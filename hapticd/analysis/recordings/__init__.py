"""Recordings of surfaces from .csv, .npz and .wav files: conversion to SI units and a uniform clock, and faults.

files     reads a recording's file as columns of numbers
clock     quantities; resampling to a uniform clock, which corrects jitter and gaps of the times
clipping  finds clipped samples
spans     finds the spans in which a mask of samples is true
sensor    response of a sensor's mounting and filter to a decaying sinusoid
"""
