"""Compiler: converts scene and materials to the table that a tick reads, flat C records in the units of a tick.

table            the compiler: keeps slots, and rewrites the records of changed objects and materials
records          arrays of C records that grow in place, and their free indices
walls            the pieces (intervals of one material) of walls with patches
materials        the materials of a scene: their records, noises, and entries in `numbers`
material_record  the record of one material, and its arrays in `numbers`, the table's array of doubles
mode_record      the record of one mode at the rate
mode_tables      modes that depend on speed or force, as tables that the tick interpolates
noise_filters    the filters of noise textures
"""
