"""Geometry of the tabletop rig: the only source of its drawings, printed parts and models.

The dimensions that a configuration needs are from `palmd.config.tabletop`.
"""

from __future__ import annotations

from dataclasses import dataclass

from palmd.config.tabletop import PALM_LENGTH_MM, STRIP_COUNTS, STRIP_LENGTH_MM, STRIP_START_MM


@dataclass(frozen=True, slots=True)
class Tabletop:
    """Lengths in mm. Positions along the axis are measured from the middle of the palms, the plane of motion."""

    # palm
    palm_length: float = PALM_LENGTH_MM
    """From the axis to the palm's end."""
    palm_width: float = 16.0
    """Width along the axis."""
    palm_thickness: float = 5.0
    """Thickness of the plate under the carrier."""
    palm_start: float = 2.0
    """From the axis to the plate's inner end; the pins are inserted from between the palms."""
    strip_start: float = STRIP_START_MM
    """From the axis to where the strip begins to sense."""
    strip_length: float = STRIP_LENGTH_MM
    """Active length of the strip."""
    strip_width: float = 14.5
    """Width of the whole strip."""
    strip_edge: float = 2.5
    """Length at each end of the strip that does not sense."""
    strip_thickness: float = 0.5
    """Thickness with adhesive."""
    skin_thickness: float = 0.1
    """Thickness of the film over the strip, whose surface must pass through the axis."""
    # carrier: holds strip and motor, vibrates along the palm on pads of foam
    carrier_thickness: float = 2.0
    """Thickness of the carrier under the strip."""
    carrier_width: float = 15.0
    """Width of the carrier, less than the palm's."""
    foam_thickness: float = 1.0
    """Thickness of a foam pad with adhesive on both sides."""
    foam_length: float = 14.0
    """Length of each foam pad along the palm; its width is the carrier's."""
    foam_pads: int = 4
    """Number of pads, spaced evenly under the strip."""
    motor_diameter: float = 8.0
    """Diameter of the coin-shaped linear resonant actuator, which moves along its axis and stands across the palm."""
    motor_thickness: float = 3.2
    """Thickness of the motor, along the palm."""
    motor_wall: float = 1.8
    """Thickness of the carrier's end wall, to which a face of the motor is glued."""
    motor_gap: float = 1.0
    """Gap between the motor and the notch in the plate."""
    tail_width: float = 12.0
    """Width of the slot for the strip's leads, in carrier and plate."""
    tail_slot: float = 2.0
    """Extent of this slot along the palm."""
    end_hole: float = 3.2
    """Diameter of the two holes beside the arm's end, for a cable tie and a rubber band."""
    # hinge
    clearance: float = 0.5
    """Gap along the axis between parts that move against each other."""
    bearing_outer: float = 10.0
    """Outer diameter of a 623 ball bearing."""
    bearing_width: float = 4.0
    """Width of this bearing."""
    pin: float = 3.0
    """Diameter of the two dowel pins about which the palms turn."""
    pin_length: float = 8.0
    """Length of each pin, which reaches from a palm's bearing into the other palm's cheek."""
    eye_wall: float = 2.5
    """Wall around a bearing."""
    arm_length: float = 60.0
    """From the axis to the end of the arm that stiffens the plate."""
    arm_depth: float = 19.0
    """Depth of that arm, measured behind the palm's surface."""
    arm_start: float = 12.0
    """From the axis to where arm and plate are joined: outside the other palm's eye."""
    # servo, of X430 size
    horn_circle: float = 16.0
    """Diameter of the circle of screws on the servo's horn."""
    horn_screw: float = 2.2
    """Diameter of their holes, for M2."""
    horn_head: float = 4.2
    """Diameter of the counterbores for their heads."""
    horn_head_depth: float = 2.0
    """Depth of the counterbores."""
    horn_boss: float = 9.0
    """Diameter of the pocket for the boss in the horn's middle."""
    horn_boss_depth: float = 3.0
    """Depth of that pocket."""
    cheek_thickness: float = 7.0
    """Thickness of the disc that is screwed to the horn."""
    cheek_edge: float = 4.0
    """Width of the disc outside the circle of screws."""
    servo_gap: float = 1.0
    """Gap between cheek and servo case."""
    servo_width: float = 28.5
    """Width of the case; width, height and depth are from the manufacturer's table."""
    servo_height: float = 46.5
    """Height of the case."""
    servo_depth: float = 34.0
    """Depth of the case along the axis."""
    servo_axis: float = 11.25
    """From the case's top to its shaft."""
    servo_screws: float = 24.0
    """Distance of the screws in the case's back."""
    servo_screw: float = 2.7
    """Diameter of their holes, for M2.5."""
    # bracket and base
    axis_height: float = 70.0
    """Height of the axis above the base plate."""
    bracket_thickness: float = 4.0
    """Thickness of the bracket's back and foot."""
    bracket_side: float = 4.0
    """Excess of the bracket's width over the servo on each side."""
    foot_length: float = 30.0
    """Length of the bracket's foot, which lies below the servo."""
    rib_height: float = 30.0
    """Height of the ribs between back and foot."""
    rib_thickness: float = 2.0
    """Thickness of each rib."""
    cable_width: float = 14.0
    """Width of the opening for the servo's cables in the bracket's back."""
    cable_height: float = 10.0
    """Height of that opening."""
    base_length: float = 160.0
    """Length of the base plate across the axis."""
    base_width: float = 124.0
    """Width of the base plate along the axis."""
    base_thickness: float = 6.0
    """Thickness of the base plate."""
    screw: float = 3.4
    """Diameter of the holes for M3."""
    nut: float = 6.4
    """Diameter of the circumscribed circle of an M3 nut."""
    nut_depth: float = 2.6
    """Depth of the nuts' pockets in the base plate."""
    foot_screw_x: float = 11.0
    """Distance of a foot's four screws from its middle line."""
    foot_screw_spacing: float = 14.0
    """Distance of its two rows of screws."""
    foot_screw_inset: float = 7.0
    """From the foot's inner end to the first row."""
    base_hole_inset: float = 5.0
    """From the base plate's edges to the four holes at its corners."""
    # printing
    bed: float = 180.0
    """Side length of the printer's bed."""

    @property
    def strip_end(self) -> float:
        """From the axis to the end of the strip's active length: the pad's `length_mm`."""
        return self.strip_start + self.strip_length

    @property
    def counts_per_mm(self) -> float:
        """The strip's scale."""
        return round(STRIP_COUNTS / self.strip_length, 2)

    @property
    def carrier_top(self) -> float:
        """Distance from the carrier to the axis: strip and skin."""
        return self.strip_thickness + self.skin_thickness

    @property
    def carrier_under(self) -> float:
        """Distance from the carrier's underside to the axis."""
        return self.carrier_top + self.carrier_thickness

    @property
    def surface(self) -> float:
        """Distance from the plate to the axis: skin, strip, carrier and foam."""
        return self.carrier_under + self.foam_thickness

    @property
    def foam_first(self) -> float:
        """From the axis to the first foam pad."""
        return self.palm_start + 0.5

    @property
    def foam_pitch(self) -> float:
        """Distance of the foam pads' middles; the last pad ends at the slot for the leads."""
        return (self.strip_end + self.strip_edge - self.foam_length - self.foam_first) / (self.foam_pads - 1)

    @property
    def motor_start(self) -> float:
        """From the axis to the motor, which is glued to the end wall."""
        return self.palm_length - self.motor_wall - self.motor_thickness

    @property
    def motor_depth(self) -> float:
        """Distance of the motor's axis from the hinge line: middle of the foam, so that its force does not tilt."""
        return self.carrier_under + 0.5 * self.foam_thickness

    @property
    def eye_radius(self) -> float:
        """Radius of the eye around a bearing."""
        return 0.5 * self.bearing_outer + self.eye_wall

    @property
    def cheek_radius(self) -> float:
        """Radius of the disc on the horn."""
        return 0.5 * self.horn_circle + self.cheek_edge

    @property
    def eye_start(self) -> float:
        """Position of the eye along the axis."""
        return 0.5 * self.palm_width + self.clearance

    @property
    def cheek_start(self) -> float:
        """Position of the cheek along the axis, beyond the other palm's eye."""
        return self.eye_start + self.bearing_width + self.clearance

    @property
    def cheek_end(self) -> float:
        """Position of the horn along the axis."""
        return self.cheek_start + self.cheek_thickness

    @property
    def servo_start(self) -> float:
        """Position of the servo along the axis."""
        return self.cheek_end + self.servo_gap

    @property
    def bracket_start(self) -> float:
        """Position of the case's back along the axis."""
        return self.servo_start + self.servo_depth


TABLETOP = Tabletop()
"""The rig described in docs/start/tabletop.md."""
