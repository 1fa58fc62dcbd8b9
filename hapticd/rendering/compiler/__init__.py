"""From scene and materials to the table that the tick reads: flat C records in the units of a tick.

table            the compiler: keeps slots, rewrites the records of what changed
records          arrays of C records that grow in place, and their free places
walls            the pieces of walls with patches
materials        the materials of a scene: their records, noises and numbers
material_record  the record of one material, and its numbers outside of the record
mode_record      the numbers of one mode at the rate
mode_tables      modes that depend on speed or force: what the tick looks up when it strikes them
noise_filters    the filters of textures that are noise
"""
