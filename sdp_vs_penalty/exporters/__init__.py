"""Formats of an exported model, one small file each. A module that offers what
:class:`sdp_vs_penalty.exporters.interface.ExportFormat` describes is a format: nothing
else registers it.
"""
