"""Formats of an exported model, one small file each. A module with the names of
:class:`sdp_vs_penalty.exporters.interface.ExportFormat` is a format, without further
registration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sdp_vs_penalty.plugins import Registry

if TYPE_CHECKING:
    from sdp_vs_penalty.exporters.interface import ExportFormat

#: Every format of export by the ending of its files.
EXPORTS: Registry[ExportFormat] = Registry("format of export", __name__, "ENDING")
