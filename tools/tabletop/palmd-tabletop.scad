// The printed parts of the tabletop rig and their assembly. Lengths in mm; all dimensions are in parameters.scad, which
// tools/tabletop/parameters.py writes from src/palmd/config/tabletop.py. x lies along a palm, y along the axis, z is up.
// One part: openscad -D 'part="palm"' -o palm.stl palmd-tabletop.scad   (palm, carrier, bracket, base, all)
include <parameters.scad>

part = "all";
angle1 = 45;   // of palm 1 in the assembly, degrees from the x axis
angle2 = 135;  // of palm 2
$fn = 64;
e = 0.01;      // overlap of a cut beyond a face

assert(arm_start > eye_radius + clearance, "an arm would hit the other palm's eye");
assert(palm_start > pin / 2, "the pins are inserted from between the palms");
assert(foot_length < servo_depth, "the foot must lie below the servo");
assert(carrier_width / 2 + clearance <= eye_start, "the carrier would rub on the eye");
assert(motor_start > strip_end + strip_edge + tail_slot + motor_gap, "the motor would touch the strip's leads");

module along_axis(y0, y1) { translate([0, y1, 0]) rotate([90, 0, 0]) linear_extrude(y1 - y0) children(); }
module block(x0, x1, y0, y1, z0, z1) { translate([x0, y0, z0]) cube([x1 - x0, y1 - y0, z1 - z0]); }

// Palm 1: the horn's cheek at +y, the eye with the bearing at -y. Palm 2 is the same part, rotated about the vertical.
module palm() {
    half = palm_width / 2;
    plate_low = -surface - palm_thickness;
    eye_end = eye_start + bearing_width;
    difference() {
        union() {
            block(palm_start, palm_length, -half, half, plate_low, -surface);
            // arm and cheek, on the side of the servo
            block(arm_start, arm_length, half - 1, cheek_end, plate_low, -surface);
            block(0, arm_length, cheek_start, cheek_end, -arm_depth, -surface);
            along_axis(cheek_start, cheek_end) circle(r = cheek_radius);
            // eye, on the other side
            along_axis(-eye_end, -eye_start) circle(r = eye_radius);
            block(palm_start, 2 * eye_radius, -eye_end, -half + 1, plate_low, -surface);
        }
        along_axis(-eye_end - e, -half) circle(d = bearing_outer);
        along_axis(cheek_start - e, cheek_end + e) circle(d = pin);
        along_axis(cheek_end - horn_boss_depth, cheek_end + e) circle(d = horn_boss);
        for (angle = [45 : 90 : 315]) rotate([0, angle, 0]) translate([horn_circle / 2, 0, 0]) {
            along_axis(cheek_start - e, cheek_end + e) circle(d = horn_screw);
            along_axis(cheek_start - e, cheek_start + horn_head_depth) circle(d = horn_head);
        }
        // openings for the strip's leads, the motor with the carrier's wall, a cable tie and a rubber band
        leads(plate_low - e, -surface + e);
        notch = motor_diameter / 2 + motor_gap;
        block(motor_start - motor_gap, palm_length + e, -notch, notch, plate_low - e, -surface + e);
        for (x = [arm_length - 4, arm_length - 10]) translate([x, (half + cheek_start) / 2, plate_low - e])
            cylinder(d = end_hole, h = palm_thickness + 2 * e);
    }
}

module leads(z0, z1) {
    tail = strip_end + strip_edge;
    block(tail, tail + tail_slot, -tail_width / 2, tail_width / 2, z0, z1);
}

// Stands on foam on the plate, in the palm's coordinates; a face of the motor is glued to the end wall.
module carrier() {
    radius = motor_diameter / 2;
    difference() {
        union() {
            block(palm_start, palm_length, -carrier_width / 2, carrier_width / 2, -carrier_under, -carrier_top);
            block(palm_length - motor_wall, palm_length, -radius, radius, -motor_depth - radius, -carrier_top);
        }
        leads(-carrier_under - e, -carrier_top + e);
        block(motor_start - motor_gap, palm_length - motor_wall, -radius - motor_gap / 2, radius + motor_gap / 2,
              -carrier_under - e, -carrier_top + e);
    }
}

// Holds one servo by its back; z = 0 is the base plate's upper face, y = 0 the servo's back, the servo at y < 0.
module bracket() {
    height = axis_height + servo_axis;
    half = servo_width / 2 + bracket_side;
    difference() {
        union() {
            block(-half, half, 0, bracket_thickness, 0, height);
            block(-half, half, -foot_length, e, 0, bracket_thickness);
            for (x = [-half, half - rib_thickness]) translate([x, 0, 0]) rotate([90, 0, 90])
                linear_extrude(rib_thickness)
                    polygon([[e, 0], [-foot_length, 0], [-foot_length, bracket_thickness], [e, rib_height]]);
        }
        for (x = [-servo_screws / 2, servo_screws / 2], z = [0, servo_screws])
            translate([x, 0, height - servo_height + 6 + z]) along_axis(-e, bracket_thickness + e) circle(d = servo_screw);
        for (x = [-foot_screw_x, foot_screw_x], y = foot_rows()) translate([x, y, -e])
            cylinder(d = screw, h = bracket_thickness + 2 * e);
        block(-cable_width / 2, cable_width / 2, -e, bracket_thickness + e, rib_height / 2, rib_height / 2 + cable_height);
    }
}

function foot_rows() = [foot_screw_inset - foot_length, foot_screw_inset + foot_screw_spacing - foot_length];

module base() {
    x = base_length / 2;
    y = base_width / 2;
    difference() {
        block(-x, x, -y, y, -base_thickness, 0);
        for (side = [-1, 1], at = [-foot_screw_x, foot_screw_x], row = foot_rows())
            translate([at, side * (bracket_start + row), -base_thickness - e]) {
                cylinder(d = screw, h = base_thickness + 2 * e);
                cylinder(d = nut, h = nut_depth + e, $fn = 6);
            }
        for (at = [-x + base_hole_inset, x - base_hole_inset], side = [-y + base_hole_inset, y - base_hole_inset])
            translate([at, side, -base_thickness - e]) cylinder(d = screw, h = base_thickness + 2 * e);
    }
}

module servo() {
    block(-servo_width / 2, servo_width / 2, servo_start, bracket_start, servo_axis - servo_height, servo_axis);
}

module all() {
    translate([0, 0, axis_height]) {
        rotate([0, -angle1, 0]) { color("steelblue") palm(); color("khaki") carrier(); }
        rotate([0, 180 - angle2, 0]) rotate([0, 0, 180]) { color("indianred") palm(); color("khaki") carrier(); }
        for (turn = [0, 180]) rotate([0, 0, turn]) color("dimgray") servo();
    }
    for (turn = [0, 180]) rotate([0, 0, turn]) translate([0, bracket_start, 0]) bracket();
    base();
}

if (part == "palm") palm();
else if (part == "carrier") carrier();
else if (part == "bracket") bracket();
else if (part == "base") base();
else all();
