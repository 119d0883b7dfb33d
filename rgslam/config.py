# SPDX-FileCopyrightText: 2026 The rgslam authors
# SPDX-License-Identifier: BSD-3-Clause
"""The one configuration, nested by stage; defaults fit every robot and building.

What depends on the sensor (beam spacing, maximum range, noise) is derived from the recording and is
not found here.
"""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rgslam.errors import ConfigError


class StageConfig(BaseModel):
    """Base of every stage's section: immutable, and a misspelt key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ScanMatchingConfig(StageConfig):
    """Local registration of every scan (see `rgslam.scan_matching`)."""

    resolution: float = Field(0.05, gt=0.0)  # m per cell of the correlative search
    local_keyframes: int = Field(12, ge=1)  # newest keyframes that a scan is aligned with
    keyframe_distance: float = Field(0.4, gt=0.0)  # m between keyframes
    keyframe_angle_deg: float = Field(20.0, gt=0.0)  # turn between keyframes
    min_inliers: float = Field(0.1, ge=0.0, le=1.0)  # share of points that must fit the local map
    doubtful_inliers: float = Field(0.6, ge=0.0, le=1.0)  # below it, odometry may be wrong


class LoopClosingConfig(StageConfig):
    """Search and acceptance of loops (see `rgslam.loop_closing`)."""

    enabled: bool = True
    resolution: float = Field(0.05, gt=0.0)  # m per cell of the global correlation
    search_every: float = Field(1.0, gt=0.0)  # m travelled between searches
    patch_length: float = Field(4.0, gt=0.0)  # m of path whose scans form the recent patch
    chunk_length: float = Field(4.0, gt=0.0)  # m of path to each side of an old place
    chunks: int = Field(3, ge=1)  # old places tried per search
    min_path: float = Field(10.0, gt=0.0)  # m travelled before a place counts as old
    min_window: float = Field(0.3, gt=0.0)  # m, smallest half width that is searched
    max_window: float = Field(12.0, gt=0.0)  # m, largest
    max_turn: float = Field(0.8, gt=0.0)  # rad, largest half angle
    tolerance: float = Field(0.15, gt=0.0)  # m, a point this near a surface agrees with it
    # Measured on eight simulated runs through look-alike hallways: of 4,154 candidates that scored
    # so much and converged, 9 were wrong. Overlap and free space refused 5 of them (and 87 right
    # ones), a second peak and other loops the rest; none of the 3,926 accepted was wrong.
    min_score: float = Field(0.4, ge=0.0, le=1.0)  # mean likelihood of the patch
    min_overlap: float = Field(0.4, ge=0.0, le=1.0)  # share of the patch on old surfaces
    min_agreement: float = Field(0.8, ge=0.0, le=1.0)  # share of the judged points that agree
    max_rival: float = Field(0.9, ge=0.0, le=1.0)  # score of the next peak relative to the best
    min_support: int = Field(3, ge=1)  # wide loops that must agree before they are believed


class FactorGraphConfig(StageConfig):
    """The joint factor graph (see `rgslam.factor_graph`)."""

    loop_kernel: float = Field(2.0, gt=0.0)  # sigmas at which the influence of a loop fades
    max_loop_sigmas: float = Field(4.6, gt=0.0)  # a loop farther off is taken back
    optimise_every: int = Field(50, ge=1)  # keyframes between optimisations while loops fit anyway
    # Unevenness of floor and suspension: roll and pitch of the robot, and its height.
    floor_tilt_deg: float = Field(0.02, gt=0.0)
    floor_height: float = Field(0.0005, gt=0.0)  # m
    # Walls along the axis of a region tell headings of keyframes far from each other. Gateway posts
    # seen in several passes change nothing measurable where loops are closed or doors are seen.
    region_axes: bool = True
    gateway_posts: bool = False
    plane_sights: bool = True  # where beams ended on a landmark tells its plane
    # px by which shading, and what is too faint to be noticed, draws the borders of a thing aside
    # in all images alike; two of three corners in simulated buildings are off by less.
    border_sigma_px: float = Field(0.15, ge=0.0)
    # The camera's mount as a variable, known beforehand as one measures by rule and eye.
    calibrate: bool = False
    mount_turn_deg: float = Field(2.0, gt=0.0)
    mount_shift: float = Field(0.03, gt=0.0)  # m


class DataAssociationConfig(StageConfig):
    """Which sight is which landmark (see `rgslam.data_association`)."""

    enabled: bool = True  # False: no landmarks, the poses come from the laser alone
    gate_probability: float = Field(0.999, gt=0.0, lt=1.0)  # share of right pairs that pass
    # By so much another pair must fit worse (chi-square, 1 in 100 by chance) to be ruled out.
    ambiguity_margin: float = Field(9.2, ge=0.0)
    # Frames that must have seen a landmark; fewer suffice where its sights together make it more
    # likely a thing than not.
    min_sights: int = Field(3, ge=1)
    min_sure_sights: int = Field(2, ge=1)
    max_overlap: float = Field(0.5, gt=0.0, le=1.0)  # of two landmarks, intersection over union


class RectangleClass(StageConfig):
    """A kind of rectangle by its size and the height of its middle, each a Gaussian (m)."""

    name: str
    width: float = Field(gt=0.0)
    width_sigma: float = Field(gt=0.0)
    height: float = Field(gt=0.0)
    height_sigma: float = Field(gt=0.0)
    middle: float
    middle_sigma: float = Field(gt=0.0)


def _class(name: str, *values: float) -> RectangleClass:
    keys = ("width", "width_sigma", "height", "height_sigma", "middle", "middle_sigma")
    return RectangleClass(name=name, **dict(zip(keys, values, strict=True)))


class LandmarkConfig(StageConfig):
    """What landmarks are called (see `rgslam.landmarks`)."""

    # Sizes as sold: doors by DIN 18101 and ANSI, writing boards and paper A3 to A0, screens of
    # 15 to 32 inches on a desk, cabinets of two to five folders' height that stand on the floor.
    # Walls of 2.4 to 3 m between floor and ceiling: what is one becomes no object of the map.
    classes: tuple[RectangleClass, ...] = (
        _class("door", 0.93, 0.10, 2.06, 0.08, 1.04, 0.05),
        _class("whiteboard/poster", 1.40, 0.50, 1.00, 0.20, 1.50, 0.20),
        _class("whiteboard/poster", 0.65, 0.20, 0.85, 0.25, 1.50, 0.20),
        _class("monitor", 0.45, 0.12, 0.32, 0.06, 1.00, 0.12),
        _class("cabinet", 0.80, 0.25, 1.30, 0.45, 0.65, 0.25),
        _class("wall", 3.00, 2.00, 2.70, 0.20, 1.35, 0.10),
    )
    largest: tuple[float, float, float] = (6.0, 3.0, 3.0)  # m, of what has no class
    in_front: float = Field(0.3, gt=0.0)  # m, where the region is looked up


class OccupancyGridConfig(StageConfig):
    """Free and occupied space (see `rgslam.occupancy_grid`)."""

    resolution: float = Field(0.05, gt=0.0)  # m per cell
    # A hit says more than a pass: a beam that grazes a wall passes through its cells.
    hit_weight: float = Field(2.0, gt=0.0)
    end_uncertainty: float = Field(
        0.05, ge=0.0
    )  # m before a hit left undecided (range noise, 95 %)
    no_return_quantile: float = Field(0.95, gt=0.0, le=1.0)  # of the ranges: reach of a lost beam
    extent_quantile: float = Field(0.999, gt=0.5, le=1.0)  # of the end points that span the grid
    largest_cells: int = Field(64_000_000, ge=1)  # 0.8 GB for the counts and the grid


class GatewayConfig(StageConfig):
    """Detection of gateways (see `rgslam.gateways`); lengths are those of doors and people."""

    door_leaf: float = Field(1.2, gt=0.0)  # m, widest single door leaf in use
    longest: float = Field(6.0, gt=0.0)  # m, longest virtual line; wider is one space for an eye
    slide: float = Field(
        0.3, gt=0.0
    )  # m, posts are moved this far to see whether a line is shortest
    post_turn_deg: float = Field(25.0, gt=0.0, lt=180.0)  # a wall that juts out by more has a post
    alignment_deg: float = Field(15.0, gt=0.0, lt=45.0)  # wider than a leaf: must continue a wall
    free_depth: float = Field(0.5, gt=0.0)  # m on either side: a robot's or a person's body
    # Width of a passage relative to the free width beside it: either side, and geometric mean.
    narrowing: float = Field(0.85, gt=0.0, le=1.0)
    mean_narrowing: float = Field(0.55, gt=0.0, le=1.0)
    # The mouth of a hallway: the space it opens into is so many times as wide, and the hallway so
    # many times as long as wide.
    widening: float = Field(2.0, gt=1.0)
    hallway_length: float = Field(1.5, gt=0.0)
    thickest_wall: float = Field(0.6, gt=0.0)  # m, a jamb deeper than that is a short hallway


class RegionConfig(StageConfig):
    """Split of the free space into regions (see `rgslam.regions`)."""

    # m, longest side of a free-standing obstacle that divides nothing: chair, bin, leg, person.
    largest_object: float = Field(0.8, ge=0.0)
    # m, the same of what is thicker than walls are: a meeting table or a counter
    largest_furniture: float = Field(4.0, ge=0.0)
    # m, its shorter side: arms reach the middle from both sides. What is more is built around.
    deepest_furniture: float = Field(1.6, ge=0.0)
    narrowest: float = Field(0.2, ge=0.0)  # m, a slit nobody and no robot fits through
    least_radius: float = Field(0.35, gt=0.0)  # m, inscribed circle: a place a person can stand in
    least_area: float = Field(
        1.5, gt=0.0
    )  # m^2, a cubicle; smaller pieces belong to their neighbour
    # Share of a piece's edge that must be wall: a view through a window or past a corner, with the
    # unknown all round, is no place of its own.
    least_seen: float = Field(0.15, ge=0.0, le=1.0)
    hallway_elongation: float = Field(3.0, gt=1.0)  # length over width
    hallway_width: float = Field(4.0, gt=0.0)  # m, widest hallway (above it is an open space)
    open_space_width: float = Field(6.0, gt=0.0)  # m, a room this wide both ways is an open space


class StereoConfig(StageConfig):
    """Depth from two cameras (see `rgslam.stereo`)."""

    nearest: float = Field(0.25, gt=0.0)  # m, a robot's bumper keeps things farther off
    # Share of the width; what is shifted by more is hardly in both images.
    max_disparity: float = Field(0.25, gt=0.0, le=1.0)
    matching_width: int = Field(192, ge=64)  # px, larger images are matched at this width
    uniqueness_percent: int = Field(10, ge=0)  # by which the best match must beat the second
    texture_sigmas: float = Field(3.0, ge=0.0)  # contrast in a window relative to the noise
    sigma_px: float = Field(0.29, gt=0.0)  # px as matched: SGBM may lock to whole ones (12^-0.5)


class RectangleConfig(StageConfig):
    """Rectangles in images (see `rgslam.rectangles`)."""

    # Line segments
    min_piece_px: float = Field(6.0, ge=2.0)  # px; shorter edges have no direction to speak of
    merge_offset_px: float = Field(1.2, gt=0.0)  # px, the detector's own error at a segment's end
    merge_bend_px: float = Field(2.0, gt=0.0)  # px by which an edge in one piece may be bent
    merge_angle_deg: float = Field(8.0, gt=0.0, lt=45.0)  # between pieces of one edge
    merge_gap: float = Field(0.3, ge=0.0)  # bridged gap relative to the longer piece
    min_side: float = Field(0.025, gt=0.0)  # shortest side relative to the image's diagonal
    max_lines: int = Field(250, ge=4)  # the longest; 0.2 s for four times as many
    refine_reach_px: float = Field(3.0, ge=1.0)  # px across a line in which its edge is searched
    edge_sigma_px: float = Field(0.07, gt=0.0)  # px by which real edges are not straight
    edge_correlation_px: float = Field(4.0, ge=1.0)  # px along an edge that err alike
    # Hypotheses
    parallel_deg: float = Field(15.0, gt=0.0, lt=90.0)  # neighbouring sides meet at more than this
    min_angle_deg: float = Field(20.0, gt=0.0, lt=90.0)  # internal angles: this .. 180 less this
    corner_gap: float = Field(1.5, ge=0.0)  # reach of a line beyond its ends, of its length
    min_side_support: float = Field(0.5, ge=0.0, le=1.0)  # share of each side that is an edge
    min_support: float = Field(0.75, ge=0.0, le=1.0)  # the same of the whole border
    max_crossings: int = Field(1, ge=0, le=4)  # corners at which both lines go on
    double_px: float = Field(2.0, ge=0.0)  # hypotheses whose corners are this close are one
    # Share of the width, largest shift of a rectangle between the images that is searched.
    max_disparity: float = Field(0.4, gt=0.0, le=1.0)
    max_hypotheses: int = Field(250, ge=1)  # the best; each takes 0.2 ms to verify
    # Shape and verification
    corner_sigma_px: float = Field(0.2, gt=0.0)  # what a good calibration leaves of lens and rows
    shape_sigmas: float = Field(4.0, gt=0.0)  # of the right angle, before depth is asked for
    # One image alone: ends of sides past which a line goes on, and how well directions are known.
    max_loose_ends: int = Field(3, ge=0, le=8)
    max_direction_sigma_deg: float = Field(2.0, gt=0.0)
    min_similarity: float = Field(0.3, ge=-1.0, le=1.0)  # of the borders in both images
    # Depth images: noise of the inverse depth (1/m; 1.5 mm at 1 m, as structured light has), error
    # of their scale at a corner (makers calibrate to about 1 %), and shares of a rectangle's inside
    # that must be known and lie on its plane.
    inverse_depth_sigma: float = Field(0.0015, gt=0.0)
    depth_scale_sigma: float = Field(0.01, ge=0.0)
    min_known_depth: float = Field(0.3, gt=0.0, le=1.0)
    min_on_plane: float = Field(0.5, gt=0.0, le=1.0)
    max_relative_sigma: float = Field(0.15, gt=0.0)  # of width and height
    # Of being a thing, after verification: of all that is likelier, seven of eight are rectangles.
    min_probability: float = Field(0.45, ge=0.0, le=1.0)
    max_overlap: float = Field(0.8, gt=0.0, le=1.0)  # of two rectangles, intersection over union


class Config(StageConfig):
    """Everything that can be set; `Config()` is the default for all robots and buildings."""

    scan_matching: ScanMatchingConfig = ScanMatchingConfig()
    loop_closing: LoopClosingConfig = LoopClosingConfig()
    factor_graph: FactorGraphConfig = FactorGraphConfig()
    data_association: DataAssociationConfig = DataAssociationConfig()
    landmarks: LandmarkConfig = LandmarkConfig()
    occupancy_grid: OccupancyGridConfig = OccupancyGridConfig()
    gateways: GatewayConfig = GatewayConfig()
    regions: RegionConfig = RegionConfig()
    stereo: StereoConfig = StereoConfig()
    rectangles: RectangleConfig = RectangleConfig()

    @classmethod
    def from_yaml(cls, path: Path | str) -> Config:
        """Read a configuration; keys that are left out keep their default.

        Raises:
            ConfigError: unreadable file, no valid YAML, unknown key or value out of range.
        """
        path = Path(path)
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise ConfigError(f"{path}: {' '.join(str(error).split())}") from error
        try:
            return cls.model_validate({} if content is None else content)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "top level"
            raise ConfigError(
                f"{path}: {place}: {first['msg']} (got {first['input']!r})"
            ) from error

    def calibrating(self) -> Config:
        """The same with the camera's mount as a variable (`--calibrate`)."""
        section = self.factor_graph.model_copy(update={"calibrate": True})
        return self.model_copy(update={"factor_graph": section})

    def to_yaml(self) -> str:
        """The whole configuration as YAML, defaults written out."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
