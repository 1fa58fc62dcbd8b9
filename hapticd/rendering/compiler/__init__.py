"""From scene and materials to the table that the tick reads: flat C records in the units of a tick.

table            the compiler itself: keeps slots, rewrites the records of what changed
records          arrays of C records that grow in place, and their free places
fields           springs, dampers and constant forces, summed to one field
walls            the pieces of walls with patches
materials        the materials of a scene: records, noises and the numbers of both
material_record  the record of one material
mode_record      the numbers of one mode at the rate
noise_filters    the filters of textures that are noise, kept for a while after their use
retired_names    names of objects that are gone, for events that still speak of them
"""
