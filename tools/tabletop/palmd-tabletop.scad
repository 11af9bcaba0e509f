// The rig for the table: palms, servo brackets, base plate. All lengths in mm. docs/start/tabletop.md says how it goes
// together; tools/make_tabletop_drawing.py draws docs/figures/tabletop.svg from the same numbers.
// One part for printing: openscad -D 'part="palm"' -o palm.stl palmd-tabletop.scad   (palm, bracket, base, all)

part = "all";

palm_length = 75;        // from the axis to the palm's end
palm_width = 16;         // along the axis
palm_thickness = 5;      // behind the strip
strip_length = 60;       // active part of the strip
strip_width = 11;        // with its edges
strip_thickness = 0.5;   // its surface must go through the axis
strip_start = 2.5;       // from the axis to where it begins to feel
hinge_eye = 6;           // radius of the eye round the pin
pin = 3;                 // diameter of the pin that both palms turn about
axis_height = 70;        // of the axis above the base plate
horn_circle = 16;        // diameter of the circle of screws on a servo's horn
horn_screw = 2.2;        // diameter of their holes
horn_boss = 9;           // diameter of the boss in the horn's middle
servo_width = 28.5;      // of an X430 servo's case
servo_height = 46.5;
servo_depth = 34;
servo_axis = 11.25;      // from the case's top to its shaft
servo_screws = 24;       // between the holes in the case's back
bracket_thickness = 4;
gap = 1;                 // between palm and bracket
base_length = 160;
base_width = 140;
base_thickness = 6;

$fn = 64;

assert(strip_start >= pin / 2 + 0.8, "no wall is left between the pin's hole and the palm's cut");

// A palm, lying along x from the axis at the origin, its upper face strip_thickness below the hinge line. The arm beside
// it carries the horn; `side` is 1 or -1, and the eyes of both palms share the pin.
module palm(side = 1) {
    difference() {
        union() {
            translate([strip_start, -palm_width / 2, -strip_thickness - palm_thickness])
                cube([palm_length - strip_start, palm_width, palm_thickness]);
            translate([0, side * palm_width / 4, 0]) rotate([90, 0, 0])
                cylinder(r = hinge_eye, h = palm_width / 2 - 0.3, center = true);
            translate([0, side * (palm_width / 2 + bracket_thickness / 2), 0]) rotate([90, 0, 0])
                cylinder(d = horn_circle + 8, h = bracket_thickness, center = true);
            translate([0, side * (palm_width / 2 + bracket_thickness / 2), -strip_thickness - palm_thickness / 2])
                translate([palm_length / 4, 0, 0])
                    cube([palm_length / 2, bracket_thickness, palm_thickness], center = true);
        }
        rotate([90, 0, 0]) cylinder(d = pin, h = 4 * palm_width, center = true);
        for (angle = [0 : 90 : 270])
            rotate([0, angle, 0]) translate([horn_circle / 2, 0, 0]) rotate([90, 0, 0])
                cylinder(d = horn_screw, h = 4 * palm_width, center = true);
        translate([0, side * (palm_width / 2 + bracket_thickness), 0]) rotate([90, 0, 0])
            cylinder(d = horn_boss, h = bracket_thickness, center = true);
        // nothing of the eye may stand above the hinge line on the object's side
        translate([strip_start, -palm_width, -strip_thickness])
            cube([palm_length, 2 * palm_width, 2 * hinge_eye]);
    }
}

// Holds one servo by its back, its shaft axis_height above the base plate.
module bracket() {
    height = axis_height + servo_axis;
    difference() {
        union() {
            translate([-servo_width / 2 - 4, 0, 0]) cube([servo_width + 8, bracket_thickness, height]);
            translate([-servo_width / 2 - 4, 0, 0]) cube([servo_width + 8, 30, bracket_thickness]);
        }
        for (x = [-servo_screws / 2, servo_screws / 2], z = [0, servo_screws])
            translate([x, -1, height - servo_height + 6 + z]) rotate([-90, 0, 0])
                cylinder(d = 2.7, h = bracket_thickness + 2);
        for (x = [-servo_width / 2, servo_width / 2])
            translate([x, 20, -1]) cylinder(d = 4.3, h = bracket_thickness + 2);
    }
}

module base() {
    difference() {
        translate([-base_length / 2, -base_width / 2, -base_thickness]) cube([base_length, base_width, base_thickness]);
        for (x = [-servo_width / 2, servo_width / 2], side = [-1, 1])
            translate([x, side * bracket_y(20), -base_thickness - 1]) cylinder(d = 4.3, h = base_thickness + 2);
    }
}

// Where a bracket's point at that depth stands, counted from the middle.
function bracket_y(depth = 0) = palm_width / 2 + bracket_thickness + gap + servo_depth + depth;

module all() {
    translate([0, 0, axis_height]) {
        rotate([0, -45, 0]) palm(1);
        rotate([0, -135, 0]) mirror([0, 0, 1]) palm(-1);
    }
    for (side = [1, -1])
        scale([1, side, 1]) translate([0, bracket_y(), 0]) bracket();
    base();
}

if (part == "palm") palm();
else if (part == "bracket") bracket();
else if (part == "base") base();
else all();
