// The picture of a pivoting grasp: the pad, the gripper above it, and the body that rotates about the pivot.

import { MM, DEFAULT_PAD_MM, THICK_MM } from "./geometry.js";
import { disc, line } from "./paths.js";
import { palmsOf } from "./quantities.js";
import { colours, ofPalm } from "./theme.js";

const PAD = { along: [1, 0], normal: [0, 1], curvature: 0 };

/** Whether the body does not penetrate the pad: it is in contact, or held above the pad. */
export function clear(object, truth) {
  const { z_m, psi_rad } = truth, touches = Object.keys(truth).some((name) => name.startsWith("touch") && truth[name]);
  const [first, second] = object.theta_rad, count = object.theta_rad.length;
  const below = Math.round((-Math.PI / 2 - psi_rad - first) / (second - first));
  return touches || object.h_m[((below % count) + count) % count] <= z_m;
}

/** Draws the contents of `store` at `now` (ms) into the context of a `scene`. */
export function draw(scene, context, store, now) {
  const estimate = store.get("palm/estimate"), [palm] = palmsOf(store.get("palm/info"));
  const padMm = palm.padM * MM || DEFAULT_PAD_MM;
  scene.begin(padMm);
  context.save();
  context.translate(-padMm / 2, 0);
  const pivot = estimate.gripper.map((place) => place * MM);
  scene.learnShape(store.get("palm/shape"));
  const seen = pivot.every(Number.isFinite);
  if (seen && Number.isFinite(estimate.psi_rad) && scene.shaped) scene.drawObject(estimate, estimate.gripper);
  const truth = store.truthful(now) ? store.get("rig/truth") : null;
  const object = store.get("rig/object");
  if (truth && clear(object, truth)) {
    scene.drawTruth(object, { ...truth, com_x_m: truth.x_m, com_y_m: truth.z_m }, [0, 0]);
  }
  context.fillStyle = colours.line;
  context.fillRect(-padMm * 0.2, -THICK_MM, padMm * 1.4, THICK_MM);
  context.fillStyle = ofPalm(palm.number);
  context.fillRect(0, -THICK_MM * 0.42, padMm, THICK_MM * 0.42);
  scene.label("pad", padMm, PAD, ofPalm(palm.number));
  if (seen) drawGripper(scene, context, pivot);
  scene.drawContact(palm, PAD, estimate, store.get("palm/contact"));
  context.restore();
  scene.drawScale();
}

/** Draws the fork that holds the body at the pivot (mm) from above. */
function drawGripper(scene, context, [x, y]) {
  context.strokeStyle = colours.ink;
  context.lineWidth = scene.thin(5);
  line(context, [x, y + 3], [x, y + 60]);
  context.lineWidth = scene.thin(2.5);
  disc(context, [x, y], 3, colours.panel);
  context.stroke();
  scene.write("gripper", x + scene.thin(40), y + 12, colours.ink, 600);
}
