# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags of ROS 1 (`.bag`) and ROS 2 (folder, `.mcap`, `.db3`), without a ROS installation.

Stamps are those of the headers; the order is that of reception. What is wrong with the images costs
the images alone: the laser is mapped all the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rgslam.errors import CalibrationError, RecordingError
from rgslam.loaders.bag_file import BagFile, BagMessage
from rgslam.loaders.bag_topics import BagTopics, choose_topics
from rgslam.loaders.bag_transforms import StaticTransforms, pose_matrix
from rgslam.loaders.bag_values import as_printed, decode_scan, header_stamp, laser_mount, yaw_of
from rgslam.loaders.carmen_survey import pile_at_the_top
from rgslam.loaders.recording import LaserFacts, Problems, ReadProgress, Recording
from rgslam.types import FloatArray, LaserScan, Message, Odometry, StereoPair

_FIRST_SCANS = 300  # looked at before the run: 30 s of a usual laser
_FIRST_TRANSFORMS = 3000  # of /tf, where /tf_static has no way to a sensor: a minute or so
_PROGRESS_MESSAGES = 64

_MALFORMED = "{count} message(s) that cannot be decoded dropped: {where}"
_NO_SCAN = "{count} scan(s) without beams or with impossible angles dropped: {where}"
_INVALID_RANGES = "{count} range(s) NaN or below the laser's minimum ignored: {where}"
_NO_POSE = "{count} odometry message(s) that hold no pose dropped: {where}"


class RosBagRecording(Recording):
    """A bag on disk."""

    def __init__(self, path: Path, topics: Mapping[str, str] | None = None) -> None:
        """Look into the bag.

        Args:
            path: folder or file.
            topics: the topic of a role (`scan`, `odom`, `left`, `right`, `left_info`,
                `right_info`) where several fit.

        Raises:
            RecordingError: it cannot be read, has no laser, or several topics fit and none is
                chosen.
        """
        self.path = path
        self._problems = Problems("message")
        self._late_warnings: list[str] = []
        self._angles: FloatArray | None = None  # of the scan before
        with BagFile(path) as bag:
            held = bag.topics()
            self._topics = choose_topics(path, held, topics or {})
            self._ros1 = bag.is_ros1
            self._warnings = [*self._topics.warnings]
            self._survey(bag)
            self._damage = bag.damage
        self.format_name = f"ROS {1 if self._ros1 else 2} bag"
        self.size_bytes = _size(path)
        self.message_counts = {f"{t.name} [{t.type.rsplit('/', 1)[-1]}]": t.count for t in held}
        used = self._used()
        self.skipped_types = frozenset(
            f"{t.name} [{t.type.rsplit('/', 1)[-1]}]" for t in held if t.name not in used
        )
        self.scan_count = sum(t.count for t in held if t.name == self._topics.scan)

    @property
    def warnings(self) -> list[str]:
        """See `Recording.warnings`."""
        damage = [self._damage] if self._damage else []
        return [*self._warnings, *damage, *self._problems.lines(), *self._late_warnings]

    def messages(self, progress: ReadProgress | None = None) -> Iterator[Message]:
        """See `Recording.messages`."""
        self._problems = Problems("message")
        self._late_warnings = []
        return self._read(self._problems, progress)

    # --- First look ----------------------------------------------------------------------------

    def _survey(self, bag: BagFile) -> None:
        """Frames, mountings, calibration, ranges: all that must be known before the first scan."""
        topics = self._topics
        scans = [m.content for m in islice(_good(bag, [topics.scan]), _FIRST_SCANS)]
        if not scans:
            raise RecordingError(f"{self.path}: no message of {topics.scan} can be read")
        base = self._base_frame(bag)
        tree = StaticTransforms()
        for message in _good(bag, topics.static_transforms):
            tree.add(message.content.transforms, static=True)
        if topics.moving_transforms:
            for message in islice(_good(bag, topics.moving_transforms), _FIRST_TRANSFORMS):
                tree.add(message.content.transforms, static=False)
        laser_frame = scans[0].header.frame_id
        if base is None:
            base = _likely_base(tree, laser_frame)
        bTl, self._upside_down, source = self._laser_mount(tree, base, laser_frame)
        no_return, largest, range_source = _range_limit(scans)
        self.laser = LaserFacts(no_return, largest, range_source, bTl, source)
        self._stereo = None
        if topics.stereo is not None:
            try:
                self._stereo = _Stereo(bag, topics, tree, base)
            except (CalibrationError, RecordingError) as error:
                self._warnings.append(f"{error}; the images are not used")

    def _base_frame(self, bag: BagFile) -> str | None:
        """The robot's own frame: the one that odometry is about."""
        if self._topics.odometry is None:
            self._warnings.append("no odometry; motion has to come from the scans alone")
            return None
        first = next(_good(bag, [self._topics.odometry]), None)
        return (first.content.child_frame_id or "base_link") if first else None

    def _laser_mount(
        self, tree: StaticTransforms, base: str, frame: str
    ) -> tuple[FloatArray, bool, str]:
        bTl = tree.between(base, frame)
        if bTl is None:
            self._warnings.append(_no_transform(base, frame, tree) + "; it is taken to sit there")
            return np.zeros(3), False, "assumed: the bag does not say"
        try:
            pose, upside_down = laser_mount(bTl)
        except ValueError as error:
            raise RecordingError(f"{self.path}: {frame}: {error}") from error
        way = f"transforms from {base} to {frame}"
        return pose, upside_down, f"{way}, upside down" if upside_down else way

    # --- Messages ------------------------------------------------------------------------------

    def _used(self) -> set[str]:
        stereo = self._topics.stereo if self._stereo else None
        names = {self._topics.scan, self._topics.odometry, *self._topics.static_transforms}
        if stereo is not None:
            names |= {stereo.left, stereo.right, stereo.left_info, stereo.right_info}
        return {name for name in names if name is not None}

    def _read(self, problems: Problems, progress: ReadProgress | None) -> Iterator[Message]:
        wanted = [self._topics.scan]
        wanted += [self._topics.odometry] if self._topics.odometry else []
        if self._stereo is not None:
            self._stereo.restart()
            wanted += [self._stereo.topics.left, self._stereo.topics.right]
        last: Odometry | None = None
        with BagFile(self.path) as bag:
            total = max(sum(t.count for t in bag.topics() if t.name in wanted), 1)
            for number, item in enumerate(bag.messages(wanted), start=1):
                if not isinstance(item, BagMessage):
                    problems.add(_MALFORMED, number)
                    continue
                message = self._message(item, last, problems)
                if isinstance(message, Odometry):
                    last = message
                if message is not None:
                    yield message
                if progress is not None and number % _PROGRESS_MESSAGES == 0:
                    progress(min(number / total, 1.0))
            self._damage = bag.damage
        if self._stereo is not None:
            self._late_warnings += self._stereo.findings()
        if progress is not None:
            progress(1.0)

    def _message(
        self, item: BagMessage, last: Odometry | None, problems: Problems
    ) -> Message | None:
        if item.topic == self._topics.scan:
            return self._scan(item, last, problems)
        if item.topic == self._topics.odometry:
            return _odometry(item, problems)
        assert self._stereo is not None  # no other topic is asked for
        return self._stereo.take(item, problems)

    def _scan(
        self, item: BagMessage, last: Odometry | None, problems: Problems
    ) -> LaserScan | None:
        found = decode_scan(item.content, self._upside_down, self.laser.no_return_from)
        if found is None:
            problems.add(_NO_SCAN, item.number)
            return None
        if found.invalid:
            problems.add(_INVALID_RANGES, item.number, found.invalid)
        # One array for all scans of a fan: whoever keeps scans keeps half as much
        if self._angles is None or not np.array_equal(self._angles, found.angles):
            self._angles = found.angles
        stamp = header_stamp(item.content)
        # Odometry of the very same moment belongs to the scan: so do robots that read both at once
        own = last.oTb if last is not None and last.stamp == stamp else None
        return LaserScan(
            stamp=stamp,
            ranges=found.ranges,
            angles=self._angles,
            max_range=self.laser.max_range,
            bTl=self.laser.bTl,
            odometry=own,
            time_offsets=found.time_offsets,
            record=item.number,
        )


class _Stereo:
    """The stereo camera of a bag."""

    def __init__(self, bag: BagFile, topics: BagTopics, tree: StaticTransforms, base: str) -> None:
        from rgslam.loaders.bag_images import (
            ImagePairing,
            rectified_camera_pose,
            stereo_calibration,
        )
        from rgslam.stereo.rectification import rectification_maps

        assert topics.stereo is not None
        self.topics = topics.stereo
        infos = [
            next(_good(bag, [name]), None)
            for name in (self.topics.left_info, self.topics.right_info)
        ]
        if infos[0] is None or infos[1] is None:
            raise CalibrationError(f"{bag.path}: no message of {self.topics.left_info} can be read")
        rectified = self.topics.rectified
        name = f"{bag.path}: {self.topics.left_info}"
        left, right = (info.content for info in infos if info is not None)
        self.calibration = stereo_calibration(left, right, name, rectified)
        image = next(_good(bag, [self.topics.left]), None)
        frame = image.content.header.frame_id if image else left.header.frame_id
        bTo = tree.between(base, frame)
        if bTo is None:
            raise CalibrationError(_no_transform(base, frame, tree))
        self.bTc = rectified_camera_pose(bTo, self.calibration)
        self._maps = rectification_maps(self.calibration)
        self._new_pairing = ImagePairing
        self.restart()

    def restart(self) -> None:
        """Forget what waits for its partner."""
        self._pairing = self._new_pairing()
        self._images = 0

    def take(self, item: BagMessage, problems: Problems) -> StereoPair | None:
        """Take an image; returns the pair that it completes."""
        from rgslam.loaders.bag_images import decode_image
        from rgslam.stereo.rectification import rectify_pair

        side = "left" if item.topic == self.topics.left else "right"
        self._images += 1
        pair = self._pairing.add(side, header_stamp(item.content), item.content)
        if pair is None:
            return None
        try:
            images = rectify_pair(decode_image(pair[1]), decode_image(pair[2]), self._maps)
        except (ValueError, CalibrationError) as error:
            reason = str(error).replace("{", "{{").replace("}", "}}")
            problems.add("{count} stereo pair(s) dropped, " + reason + ": {where}", item.number)
            return None
        return StereoPair(
            pair[0], *images, self.calibration.camera, self.bTc, self._maps.valid, item.number
        )

    def findings(self) -> list[str]:
        """What was wrong with the pairs, once all images have been seen."""
        paired, lonely = self._pairing.paired, self._images - 2 * self._pairing.paired
        if not paired and self._images:
            gap = self._pairing.nearest
            near = f"the nearest two are {1e3 * gap:.1f} ms apart" if math.isfinite(gap) else "none"
            return [
                f"the stamps of {self.topics.left} and {self.topics.right} never match ({near}); "
                "the images are not used"
            ]
        # An image at either end of a recording is nothing to speak of
        return [f"{lonely} images have no partner of the same stamp"] if lonely > 2 else []


def _good(bag: BagFile, topics: Any) -> Iterator[BagMessage]:
    return (item for item in bag.messages(topics) if isinstance(item, BagMessage))


def _odometry(item: BagMessage, problems: Problems) -> Odometry | None:
    pose = item.content.pose.pose
    matrix = pose_matrix(pose.position, pose.orientation)
    if matrix is None:
        problems.add(_NO_POSE, item.number)
        return None
    yaw = as_printed(yaw_of(matrix))
    oTb = np.array([pose.position.x, pose.position.y, yaw])
    return Odometry(header_stamp(item.content), oTb, item.number)


def _range_limit(scans: list[Any]) -> tuple[float, float, str]:
    """(reading from which on there was no return, largest return, where they are known from)."""
    stated = as_printed(np.float32(scans[0].range_max))
    limit = stated if math.isfinite(stated) and stated > 0.0 else math.inf
    readings = np.concatenate([np.asarray(scan.ranges, float) for scan in scans])
    directions = np.concatenate([np.linspace(0.0, 1.0, len(scan.ranges)) for scan in scans])
    usable = np.isfinite(readings) & (readings > 0.0) & (readings < limit)
    pile = pile_at_the_top(readings[usable], directions[usable])
    if pile is not None and pile < limit:
        return pile, pile, f"readings without a return pile up from {pile:.2f} m"
    return limit, limit, "range_max of the scans"


def _likely_base(tree: StaticTransforms, laser: str) -> str:
    """The robot's frame where no odometry names it."""
    names = ("base_link", "base_footprint")
    return next((name for name in names if tree.between(name, laser) is not None), tree.root(laser))


def _no_transform(base: str, frame: str, tree: StaticTransforms) -> str:
    known = ", ".join(tree.frames()[:12]) or "none"
    return f"no transform from {base} to {frame} in /tf_static (frames there: {known})"


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [p for p in path.iterdir() if p.is_file()]
    return sum(file.stat().st_size for file in files)
