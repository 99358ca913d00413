"""The user's own file of a robot, into which a model's numbers are put: its bytes, and
which of its joints and links are the model's.

lxml parses the file; a scan finds where each element's tags lie in its bytes. New
elements replace these bytes alone, so that all others stay: quotes, spaces in tags, line
ends.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from lxml import etree

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

REMEDY = "give the file of the robot that was identified"
#: Two axes coincide if they are no farther apart than this, in distance [m] and in unit
#: vectors: rounded DH tables leave as much.
_NEAR = 1e-4

#: Comments, CDATA and instructions, whose < and > are no tag's; or a whole tag, whose
#: quotes may hold a >.
_MARKUP = re.compile(
    rb"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|(?P<tag><(?:[^"'>]|"[^"]*"|'[^']*')*>)""",
    re.DOTALL,
)
Attributes = Mapping[str, str]
Children = Mapping[str, Attributes]


@dataclass
class Document:
    """An XML file, its parsed tree, and where each of its elements sits in the bytes."""

    #: Bytes of the file.
    source: bytes
    #: Root of the parsed tree.
    root: Any
    #: Place of each element in the bytes: start of the start tag, its end, start of the
    #: end tag or None for <a/>.
    spans: dict[Any, tuple[int, int, int | None]]
    #: Changes of the bytes: start, end and the new text.
    _changes: list[tuple[int, int, bytes]] = field(default_factory=list)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a URDF or MJCF file that its reader has accepted.

        Returns
        -------
        Document
            Its bytes, and where each element lies in them.

        Raises
        ------
        InputError
            If it has a document type, or an encoding that does not contain ASCII.
        """
        source = read_bytes(Path(path))
        if b"<!DOCTYPE" in source:
            raise InputError(
                "files with a <!DOCTYPE> are not edited", "remove it", path
            )
        root = etree.fromstring(
            source, etree.XMLParser(resolve_entities=False, no_network=True)
        )
        encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
        if encoding not in ("UTF-8", "ASCII", "US-ASCII", "ISO-8859-1", "LATIN-1"):
            raise InputError(
                f"the encoding {encoding} is not edited", "save the file as UTF-8", path
            )
        elements = [e for e in root.iter() if isinstance(e.tag, str)]
        return cls(source, root, dict(zip(elements, _spans(source), strict=True)))

    def put(
        self,
        parent: Any,
        tag: str,
        attributes: Attributes,
        children: Children = MappingProxyType({}),
    ) -> None:
        """Replace a child of an element, or append it; each new element gets its own
        line.

        A replaced child keeps its other attributes. The change is applied by
        :meth:`edited`.

        Parameters
        ----------
        parent : element
            The element whose child changes.
        attributes : mapping
            New attributes of the child.
        children : mapping
            Attributes of its children, by their names.
        """
        old_child = parent.find(tag)
        new_child = etree.Element(
            tag, {} if old_child is None else dict(old_child.attrib)
        )
        new_child.attrib.update(attributes)
        for name, child_attributes in children.items():
            etree.SubElement(new_child, name, dict(child_attributes))
        etree.indent(new_child)
        text = etree.tostring(new_child)
        if old_child is not None:
            start, end, closing = self.spans[old_child]
            stop = end if closing is None else self.source.index(b">", closing) + 1
            text = text.replace(b"\n", self._newline(start))
            self._changes.append((start, stop, text))
            return
        start, end, closing = self.spans[parent]
        newline = self._newline(start)
        line = newline + b"  " + text.replace(b"\n", newline + b"  ")
        if closing is None:  # <parent/> becomes <parent> ... </parent>
            end_tag = b"</" + parent.tag.encode() + b">"
            self._changes.append((end - 2, end, b">" + line + newline + end_tag))
            return
        # Behind the parent's last child, before the line of its end tag.
        place = max(len(self.source[:closing].rstrip(b" \t\r\n")), end)
        if place == closing:  # the end tag gets a line of its own
            line += newline
        self._changes.append((place, place, line))

    def change(
        self, changed: Any, attributes: Attributes, *, keep: bool = True
    ) -> None:
        """Give an element's start tag other attributes; its children stay.

        Parameters
        ----------
        attributes : mapping
            New attributes.
        keep : bool
            Whether its other attributes stay.
        """
        new = etree.Element(changed.tag, dict(changed.attrib) if keep else {})
        new.attrib.update(attributes)
        start, end, closing = self.spans[changed]
        text = etree.tostring(new)
        if closing is not None:
            text = text.removesuffix(b"/>") + b">"
        self._changes.append((start, end, text))

    def _newline(self, start: int) -> bytes:
        """Return a line end of the file with the indentation of the line at ``start``."""
        line_start = self.source.rfind(b"\n", 0, start) + 1
        before = self.source[line_start:start]
        indentation = before[: len(before) - len(before.lstrip())]
        line_end = b"\r\n" if b"\r\n" in self.source else b"\n"
        return line_end + indentation

    def edited(self) -> bytes:
        """Return the file's bytes with all changes applied."""
        out: list[bytes] = []
        last = 0
        # Insertions at one place stay in the order in which they were asked for.
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            out += [self.source[last:start], text]
            last = end
        return b"".join([*out, self.source[last:]])


def _spans(source: bytes) -> list[tuple[int, int, int | None]]:
    """Return where the tags of every element lie in the bytes, in document order.

    For each: begin and end of the start tag, and begin of the end tag (None for <a/>).
    The file must be well-formed.
    """
    spans: list[tuple[int, int, int | None]] = []
    open_elements: list[int] = []  # their indices, the innermost last
    for match in _MARKUP.finditer(source):
        tag = match["tag"]
        if tag is None:  # a comment, text or instruction
            continue
        if tag.startswith(b"</"):
            k = open_elements.pop()
            begin, end, _ = spans[k]
            spans[k] = begin, end, match.start()
            continue
        if not tag.endswith(b"/>"):
            open_elements.append(len(spans))
        spans.append((*match.span(), None))
    return spans


def order_of_joints(
    path: str | Path, file_robot: Robot, model_robot: Robot
) -> list[int]:
    """Return for each joint of the file's tree the index of the model's joint.

    Joints correspond by name if all names agree, else by order. Raises InputError for
    another number of joints.
    """
    if (file_robot.n, len(file_robot.tree), file_robot.links) != (
        model_robot.n,
        len(model_robot.tree),
        model_robot.links,
    ):
        what = (
            f"the file has {formatting.count(file_robot.n, 'moving joint')}, the model"
            f" {model_robot.n}"
        )
        raise InputError(what, REMEDY, path)
    names = [joint.name for joint in model_robot.tree]
    if sorted(names) == sorted(joint.name for joint in file_robot.tree):
        return [names.index(joint.name) for joint in file_robot.tree]
    return list(range(len(model_robot.tree)))


def in_frames_of(
    path: str | Path,
    file_robot: Robot,
    model_robot: Robot,
    links: Array,
    order: list[int],
) -> Array:
    """Return the links' standard parameters about the link frames of the user's file.

    The model's frames may lie elsewhere on the same joint axes (a DH table against a
    URDF). With the poses T of corresponding joint frames at q = 0, parameters are
    transformed by T_file^-1 T_model.

    Parameters
    ----------
    path : path
        The file, for error messages.
    file_robot, model_robot : Robot
        Kinematics of the file and of the model.
    links : (links, 10) array
        Standard parameters about the model's joint frames.
    order : list of int
        For each joint of the file the model's joint.

    Raises
    ------
    InputError
        If two corresponding joint axes do not coincide.
    """
    poses_of_file = file_robot.poses(np.zeros((1, len(file_robot.tree))))[0]
    poses_of_model = model_robot.poses(np.zeros((1, len(model_robot.tree))))[0]
    link_of_joint = dict(zip(model_robot.link_joints, links, strict=True))
    transformed = []
    for index, (joint, k) in enumerate(zip(file_robot.tree, order, strict=True)):
        other = model_robot.tree[k]
        relation = np.linalg.inv(poses_of_file[index]) @ poses_of_model[k]
        parent = -1 if joint.parent < 0 else order[joint.parent]
        is_alike = joint.kind == other.kind and parent == other.parent
        what = f"joint {joint.name!r} is not joint {other.name!r} of the model"
        axis_of_other = relation[:3, :3] @ other.axis
        if not is_alike or np.linalg.norm(axis_of_other - joint.axis) > _NEAR:
            raise InputError(
                f"{what} (another kind, parent or direction of its axis)", REMEDY, path
            )
        offset = relation[:3, 3]
        across = float(np.linalg.norm(offset - joint.axis * (joint.axis @ offset)))
        # A prismatic joint has a direction, but no place.
        if joint.kind == "revolute" and across > _NEAR:
            raise InputError(
                f"{what}: its axis lies {1e3 * across:.3g} mm away", REMEDY, path
            )
        if index in file_robot.link_joints:
            link = link_of_joint[k]
            is_same_frame = np.array_equal(relation, np.eye(4))
            transformed.append(
                link if is_same_frame else inertia.transform(relation) @ link
            )
    return np.array(transformed)
