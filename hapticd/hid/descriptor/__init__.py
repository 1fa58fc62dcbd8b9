"""HID report descriptors: from their items to the reports and axes that are driven.

parser        items, as the HID specification has them
layout        the reports of the PID class and the axes, found in a descriptor: usages, how a field is found, a table
fields        a number of a report: where it lies, and its range
"""
