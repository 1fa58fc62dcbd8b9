"""HID report descriptors: from their items to the reports and axes that are driven.

parser        parses the items of a report descriptor into fields and collections
layout        finds the reports of the PID class and the axes: usages, and rules by which reports and fields are found
fields        one field of a report: its offset, its range and its unit
"""
