// Scenes: points with their errors in space, turned by mouse, finger or arrow keys, and drawn on a canvas.
"use strict";
(() => {
  const FROM_MM = 1000;
  const SCALE = 74; // pixels at the top that colours, marks and ranges are told in
  const BESIDE = 12; // pixels from an axis's end to its name
  const NEAR = 14; // pixels within which a point is told
  const DARKER = [[179, 167, 114], [125, 124, 120], [67, 78, 108], [0, 34, 78]]; // the larger the error; readable in grey
  const FIRST = { turn: -0.65, tilt: 0.42, zoom: 1 };
  const EDGES = [[0, 1], [0, 2], [0, 4], [1, 3], [1, 5], [2, 3], [2, 6], [3, 7], [4, 5], [4, 6], [5, 7], [6, 7]];

  function colour(share) {
    const place = Math.min(Math.max(share, 0), 1) * (DARKER.length - 1);
    const k = Math.min(Math.floor(place), DARKER.length - 2);
    const mixed = DARKER[k].map((from, i) => Math.round(from + (place - k) * (DARKER[k + 1][i] - from)));
    return `rgb(${mixed.join(",")})`;
  }

  function round(factor) {
    const power = 10 ** Math.floor(Math.log10(factor));
    return Math.round(factor / power) * power;
  }

  function start(box) {
    const { columns, shown, factor: enlarged, told: telling, arm } = JSON.parse(box.querySelector("script").textContent);
    const values = (name) => ((all) => shown.map((row) => all[row]))(data.column(columns[name]));
    const along = (names) => ((all) => shown.map((_, k) => all.map((one) => one[k])))(names.map(values));
    const canvas = box.querySelector("canvas");
    const pen = canvas.getContext("2d");
    const told = box.querySelector(".told");
    const control = (name) => box.querySelector(`[data-does=${name}]`);
    const points = along(["x_mm", "y_mm", "z_mm"]);
    const errors = along(["dx_mm", "dy_mm", "dz_mm"]);
    const [held, size] = ["held_out", "error_mm"].map(values);
    const names = along(telling).map((row) => row.map((value, i) => `${telling[i]} ${value}`).join(", "));
    const largest = Math.max(...size, 1e-12);
    const within = [...points, ...(arm ? arm.links.flat() : [])];
    const low = [0, 1, 2].map((i) => within.reduce((least, point) => Math.min(least, point[i]), Infinity));
    const high = [0, 1, 2].map((i) => within.reduce((most, point) => Math.max(most, point[i]), -Infinity));
    const middle = low.map((value, i) => (value + high[i]) / 2);
    const reach = Math.hypot(...high.map((value, i) => value - low[i])) / 2 || 1;
    let view = { ...FIRST };
    let factor = enlarged;
    let seen = []; // of each point drawn: its place on the canvas and its number
    let waiting = false;

    function project(point) {
      const [x, y, z] = point.map((value, i) => (value - middle[i]) / reach);
      const across = Math.cos(view.turn) * x - Math.sin(view.turn) * y;
      const away = Math.sin(view.turn) * x + Math.cos(view.turn) * y;
      const up = Math.cos(view.tilt) * z + Math.sin(view.tilt) * away;
      const depth = Math.cos(view.tilt) * away - Math.sin(view.tilt) * z;
      const size = 0.5 * Math.min(canvas.clientWidth, canvas.clientHeight - SCALE) * view.zoom;
      return [canvas.clientWidth / 2 + size * across, (canvas.clientHeight + SCALE) / 2 - size * up, depth];
    }

    function line(from, to) {
      pen.beginPath();
      pen.moveTo(from[0], from[1]);
      pen.lineTo(to[0], to[1]);
      pen.stroke();
    }

    function drawBox() {
      const corner = (k) => project([0, 1, 2].map((i) => ((k >> i) & 1 ? high : low)[i]));
      pen.strokeStyle = "#c9ced6";
      pen.lineWidth = 1;
      for (const [from, to] of EDGES) line(corner(from), corner(to));
      pen.fillStyle = "#1a1a1a";
      pen.font = "12px system-ui, sans-serif";
      pen.textAlign = "center";
      ["x", "y", "z"].forEach((name, i) => {
        const [from, to] = [corner(0), corner(1 << i)];
        pen.strokeStyle = "#444";
        pen.lineWidth = 1.5;
        line(from, to);
        const [right, down] = [to[0] - from[0], to[1] - from[1]];
        const beyond = BESIDE / (Math.hypot(right, down) || 1);
        pen.fillText(name, to[0] + beyond * right, to[1] + beyond * down + 4);
      });
    }

    const posed = () => (arm && control("robot").checked ? Number(control("pose").value) : -2); // no row has this pose

    function drawRobot() {
      if (posed() < 0) return;
      const joints = arm.links[posed()].map(project);
      pen.strokeStyle = "#7f8790";
      pen.lineCap = pen.lineJoin = "round";
      pen.lineWidth = 7;
      for (const [from, to] of arm.edges) line(joints[from], joints[to]);
      pen.lineWidth = 2;
      points.forEach((point, k) => { if (arm.pose[k] === posed()) line(joints[joints.length - 1], project(point)); });
      pen.fillStyle = "#c8641b";
      for (const [x, y] of joints) {
        pen.beginPath();
        pen.arc(x, y, 3.5, 0, 2 * Math.PI);
        pen.fill();
      }
    }

    function drawPoints() {
      const shows = [control("used").checked, control("held").checked];
      const rows = points.map((point, k) => k).filter((k) => shows[held[k] ? 1 : 0] && points[k][0] !== null);
      seen = rows.map((k) => [...project(points[k]), k]).sort((a, b) => b[2] - a[2]);
      for (const [x, y, , k] of seen) {
        pen.strokeStyle = pen.fillStyle = colour(size[k] / largest);
        if (errors[k][0] !== null) {
          pen.lineWidth = arm && arm.pose[k] === posed() ? 3 : 1.4;
          line([x, y], project(points[k].map((value, i) => value + factor * errors[k][i])));
        }
        pen.beginPath();
        if (held[k]) {
          pen.moveTo(x, y - 4);
          pen.lineTo(x + 4, y + 3);
          pen.lineTo(x - 4, y + 3);
        } else {
          pen.arc(x, y, 2.6, 0, 2 * Math.PI);
        }
        pen.fill();
      }
    }

    function drawScale() {
      const [left, top, width] = [12, 12, 90];
      for (let i = 0; i < width; i++) {
        pen.fillStyle = colour(i / width);
        pen.fillRect(left + i, top, 1, 9);
      }
      pen.fillStyle = "#1a1a1a";
      pen.font = "12px system-ui, sans-serif";
      pen.textAlign = "left";
      pen.fillText("0", left, top + 22);
      pen.fillText(`${largest.toPrecision(2)} mm`, left + width - 20, top + 22);
      pen.fillText("● used for the fit   ▲ held out", left, top + 40);
      const range = (name, i) => `${name} ${[low, high].map((end) => (end[i] / FROM_MM).toFixed(2)).join(" … ")}`;
      pen.fillText(`${["x", "y", "z"].map(range).join("   ")} m`, left, top + 58);
    }

    function draw() {
      waiting = false;
      const dots = window.devicePixelRatio || 1;
      const [width, height] = [canvas.clientWidth, Math.round(Math.min(Math.max(0.75 * canvas.clientWidth, 340), 640))];
      canvas.style.height = `${height}px`;
      canvas.width = Math.round(width * dots);
      canvas.height = Math.round(height * dots);
      pen.setTransform(dots, 0, 0, dots, 0, 0);
      pen.fillStyle = "#fff";
      pen.fillRect(0, 0, width, height);
      drawBox();
      drawRobot();
      drawPoints();
      drawScale();
      box.querySelector(".factor").textContent = factor.toLocaleString("en");
    }

    function changed(more) {
      view = { ...view, ...more };
      view.tilt = Math.min(Math.max(view.tilt, -Math.PI / 2), Math.PI / 2);
      view.zoom = Math.min(Math.max(view.zoom, 0.4), 12);
      if (!waiting) {
        waiting = true;
        requestAnimationFrame(draw);
      }
    }

    const turned = (right, down) => changed({ turn: view.turn - 0.008 * right, tilt: view.tilt + 0.008 * down });
    const nearer = (times) => changed({ zoom: view.zoom * times });

    function tell(event) {
      const frame = canvas.getBoundingClientRect();
      const [x, y] = [event.clientX - frame.left, event.clientY - frame.top];
      let [best, least] = [-1, NEAR];
      for (const [px, py, , k] of seen) {
        const away = Math.hypot(px - x, py - y);
        if (away < least) [best, least] = [k, away];
      }
      told.textContent = best < 0 ? "Drag to turn; point at a row to read it."
        : `${names[best]}: ${size[best].toPrecision(3)} mm${held[best] ? " (held out)" : ""}`;
    }

    const fingers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      tell(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return tell(event);
      const now = [event.clientX, event.clientY];
      if (fingers.size === 1) turned(now[0] - before[0], now[1] - before[1]);
      else {
        const [, other] = [...fingers].find(([finger]) => finger !== event.pointerId);
        const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
        nearer(apart(now) / apart(before));
      }
      fingers.set(event.pointerId, now);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the page scrolls
      event.preventDefault();
      nearer(Math.exp(-0.01 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const keys = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] };
      if (keys[event.key]) turned(...keys[event.key]);
      else if (event.key === "+") nearer(1.2);
      else if (event.key === "-") nearer(1 / 1.2);
      else if (event.key === "Home") changed(FIRST);
      else return;
      event.preventDefault();
    });
    control("nearer").addEventListener("click", () => nearer(1.3));
    control("farther").addEventListener("click", () => nearer(1 / 1.3));
    control("reset").addEventListener("click", () => {
      control("factor").value = 150;
      factor = enlarged;
      changed(FIRST);
    });
    control("factor").value = 150;
    control("factor").addEventListener("input", (event) => {
      factor = round(enlarged * 10 ** ((event.target.value - 150) / 100));
      changed({});
    });
    if (arm) {
      control("robot").addEventListener("change", () => changed({}));
      control("pose").addEventListener("input", () => {
        const rows = points.map((_, k) => k).filter((k) => arm.pose[k] === posed()).sort((a, b) => size[b] - size[a]);
        told.textContent = rows.length ? `${names[rows[0]]}: ${size[rows[0]].toPrecision(3)} mm${rows.length > 1 ? ", the largest there" : ""}` : "";
        changed({});
      });
    }
    for (const name of ["used", "held"]) control(name).addEventListener("change", () => changed({}));
    new ResizeObserver(() => changed({})).observe(box);
    draw();
  }

  for (const box of document.querySelectorAll(".scene")) start(box);
})();
