// Plays a run back on the report's page from data embedded in the page; nothing is fetched.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const root = document.getElementById("player");
  root.hidden = false;
  const scene = root.querySelector("canvas"), strip = root.querySelectorAll("canvas")[1];
  const slider = root.querySelector("input"), button = root.querySelector("button"), list = root.querySelector("dl");
  const column = Object.fromEntries(data.columns.map((name, i) => [name, i]));
  const frames = data.frames, PALM = 60e3; // µm drawn of each palm
  // the point on a palm at distance s from the hinge: arcs bend towards the object, palm 1 to its left and palm 2 to its right
  const SIDES = [1, -1];
  const onPalm = (row, i, s) => {
    const half = SIDES[i] * data.curvatures[i] * s / 2, way = at(row, "way" + (i + 1)) / 1e3 + half;
    const chord = half ? s * Math.sin(half) / half : s;
    return [chord * Math.cos(way), chord * Math.sin(way)];
  };
  const palm = (row, i) => {
    const curvature = data.curvatures[i], length = curvature ? Math.min(PALM, Math.PI / 2 / Math.abs(curvature)) : PALM, pieces = curvature ? 24 : 1;
    return Array.from({ length: pieces + 1 }, (_, n) => onPalm(row, i, length * n / pieces));
  };
  const SHADES = [[20, "#08519c"], [50, "#4292c6"], [200, "#fd8d3c"], [Infinity, "#a63603"]]; // upper limit of the sd (µm), colour
  const STATE = { tracking: "#9ecae1", hold: "#fdd0a2", fault: "#e6550d" };

  // x = h n + h' dn/dθ on even normals, h' by central differences
  const curve = (theta0, h) => h.map((r, i) => {
    const n = h.length, theta = theta0 + 2 * Math.PI * i / n;
    const slope = (h[(i + 1) % n] - h[(i + n - 1) % n]) * n / (4 * Math.PI);
    return [r * Math.cos(theta) - slope * Math.sin(theta), r * Math.sin(theta) + slope * Math.cos(theta)];
  });
  const at = (row, name) => row[column[name]];
  const reach = frames.reduce((box, row) => {
    const outline = data.outlines[at(row, "outline")];
    const radius = outline ? Math.max(...outline.h) : 10e3;
    const ends = [0, 1].map((i) => palm(row, i).at(-1));
    const xs = [0, ...ends.map(([x]) => x), at(row, "x") - radius, at(row, "x") + radius];
    const ys = [0, ...ends.map(([, y]) => y), at(row, "y") - radius, at(row, "y") + radius];
    return [Math.min(box[0], ...xs), Math.max(box[1], ...xs), Math.min(box[2], ...ys), Math.max(box[3], ...ys)];
  }, [Infinity, -Infinity, Infinity, -Infinity]);

  function fitCanvas(canvas, height) {
    const ratio = window.devicePixelRatio || 1, width = canvas.parentElement.clientWidth;
    canvas.width = width * ratio; canvas.height = height * ratio;
    canvas.style.width = width + "px"; canvas.style.height = height + "px";
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    return [pen, width, height];
  }

  function draw(number) {
    const row = frames[number], height = Math.min(420, root.clientWidth * 0.75);
    const [pen, width] = fitCanvas(scene, height);
    const scale = 0.94 * Math.min(width / (reach[1] - reach[0]), height / (reach[3] - reach[2]));
    const px = (x, y) => [width / 2 + scale * (x - (reach[0] + reach[1]) / 2), height / 2 - scale * (y - (reach[2] + reach[3]) / 2)];
    const line = (points, colour, thickness, dashes = []) => {
      pen.beginPath(); points.forEach((p, i) => i ? pen.lineTo(...px(...p)) : pen.moveTo(...px(...p)));
      pen.strokeStyle = colour; pen.lineWidth = thickness; pen.setLineDash(dashes); pen.stroke(); pen.setLineDash([]);
    };
    pen.lineCap = pen.lineJoin = "round";
    for (const i of [0, 1]) {
      line(palm(row, i), "#777", 4);
      pen.beginPath(); pen.arc(...px(...onPalm(row, i, at(row, "s" + (i + 1)))), 5, 0, 7); pen.fillStyle = "#d55e00"; pen.fill();
    }
    const outline = data.outlines[at(row, "outline")], psi = at(row, "psi") / 1e3;
    const place = (points) => points.map(([x, y]) => [at(row, "x") + x * Math.cos(psi) - y * Math.sin(psi), at(row, "y") + x * Math.sin(psi) + y * Math.cos(psi)]);
    if (outline && at(row, "valid")) {
      const points = place(curve(outline.theta0, outline.h)), n = points.length;
      const truth = data.truth[outline.object];
      if (truth) { const real = place(curve(outline.theta0, truth)); line([...real, real[0]], "#000", 1, [5, 3]); }
      for (let i = 0; i < n; i++) {
        const shade = SHADES.find(([most]) => outline.sd[i] <= most)[1];
        line([points[i], points[(i + 1) % n]], shade, outline.touched[i] === "1" ? 3.5 : 1.2);
      }
      line([[at(row, "x") - 1500, at(row, "y")], [at(row, "x") + 1500, at(row, "y")]], "#000", 1);
      line([[at(row, "x"), at(row, "y") - 1500], [at(row, "x"), at(row, "y") + 1500]], "#000", 1);
    }
    const t = at(row, "t"), during = (intervals) => intervals.filter(([begin, end]) => begin <= t && t <= end).map((interval) => interval[2]);
    const micro = (value) => value === null ? "–" : "± " + value + " µm";
    const readouts = [
      ["time", (t / 1e3).toFixed(2) + " s"],
      ["state", (during(data.states)[0] || "–") + (at(row, "valid") ? "" : ", no valid estimate")],
      ["segment", during(data.segments)[0] || "–"],
      ["touched", at(row, "touched") === null ? "–" : (at(row, "touched") / 10).toFixed(0) + " %"],
      ["outline where touched, typical sd", outline && at(row, "valid") ? micro(outline.typical) : "–"],
      ["whole outline, worst sd", outline && at(row, "valid") ? micro(outline.worst) : "–"],
      ["mass", at(row, "mass") === null || !at(row, "valid") ? "–" : (at(row, "mass") / 1e3).toFixed(1) + (at(row, "mass_sd") === null ? "" : " ± " + (at(row, "mass_sd") / 1e3).toFixed(1)) + " g"],
      ["faults", during(data.faults).join("; ") || "none"],
    ];
    if (!list.children.length) list.append(...readouts.flatMap(() => [document.createElement("dt"), document.createElement("dd")]));
    readouts.flat().forEach((text, i) => { list.children[i].textContent = text; });
    slider.setAttribute("aria-valuetext", (t / 1e3).toFixed(1) + " seconds");
    timeline(t);
  }

  function timeline(t) {
    const [pen, width, height] = fitCanvas(strip, 44), x = (ms) => width * ms / data.duration;
    for (const [begin, end, what] of data.states) { pen.fillStyle = STATE[what] || "#e3e3e3"; pen.fillRect(x(begin), 30, x(end) - x(begin), 10); }
    for (const [begin, end] of data.faults) { pen.fillStyle = "#c00"; pen.fillRect(x(begin), 41, Math.max(1.5, x(end) - x(begin)), 3); }
    pen.beginPath();
    frames.forEach((row, i) => { const p = [x(at(row, "t")), 28 - 26 * (at(row, "touched") || 0) / 1e3]; i ? pen.lineTo(...p) : pen.moveTo(...p); });
    pen.strokeStyle = "#08519c"; pen.lineWidth = 1.5; pen.stroke();
    pen.fillStyle = "#000"; pen.fillRect(x(t) - 0.75, 0, 1.5, height);
  }

  let playing = 0, startedAt = 0;
  const stop = () => { cancelAnimationFrame(playing); playing = 0; button.textContent = "Play"; };
  const show = () => draw(Number(slider.value));
  const nearest = (t) => { let i = frames.findIndex((row) => at(row, "t") >= t); return i < 0 ? frames.length - 1 : i; };
  function step(now) {
    slider.value = nearest(now - startedAt); show();
    if (Number(slider.value) >= frames.length - 1) stop(); else playing = requestAnimationFrame(step);
  }
  button.addEventListener("click", () => {
    if (playing) return stop();
    if (Number(slider.value) >= frames.length - 1) slider.value = 0;
    button.textContent = "Pause";
    startedAt = performance.now() - at(frames[Number(slider.value)], "t");
    playing = requestAnimationFrame(step);
  });
  slider.addEventListener("input", () => { stop(); show(); });
  strip.addEventListener("click", (event) => { stop(); slider.value = nearest(data.duration * event.offsetX / strip.clientWidth); show(); });
  window.addEventListener("resize", show);
  slider.max = frames.length - 1; slider.value = frames.findLastIndex((row) => at(row, "valid"));
  show();
})();
