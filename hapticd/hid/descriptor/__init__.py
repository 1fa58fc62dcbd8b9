"""What a HID report descriptor says: its items (parser), and of them the reports and axes to be driven (layout)."""
