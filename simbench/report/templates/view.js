"use strict";

/* A view of points and lines in space that turns: azimuth about the world's z, elevation, zoom. */
class View {
  static HOME = { azimuth: -0.6, elevation: 0.6, zoom: 1 };

  constructor(figure) {
    this.canvas = figure.querySelector("canvas");
    this.layers = JSON.parse(figure.querySelector('script[type="application/json"]').textContent);
    this.shown = this.layers.map(() => true);
    this.pointers = new Map();
    Object.assign(this, View.HOME);
    this.#measure();
    for (const box of figure.querySelectorAll("input[data-layer]")) {
      box.addEventListener("change", () => {
        this.shown[box.dataset.layer] = box.checked;
        this.draw();
      });
    }
    this.#listen();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  /* Centre and radius of what is to be seen. Lines count whole, of dots the middle 96 %. */
  #measure() {
    const low = [], high = [];
    for (let axis = 0; axis < 3; axis++) {
      const ends = [];
      for (const { shape, mm } of this.layers.filter((layer) => layer.mm.length)) {
        const values = mm.filter((_, i) => i % 3 === axis).sort((a, b) => a - b);
        const cut = shape === "dots" ? Math.floor(0.02 * values.length) : 0;
        ends.push(values[cut], values[values.length - 1 - cut]);
      }
      low.push(Math.min(...ends));
      high.push(Math.max(...ends));
    }
    this.centre = low.map((value, axis) => (value + high[axis]) / 2);
    this.floor = low[2];
    this.radius = Math.max(Math.hypot(...low.map((value, axis) => high[axis] - value)) / 2, 500);
  }

  #listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.#turn(0, 0, Math.exp(-0.001 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => {
      Object.assign(this, View.HOME);
      this.draw();
    });
    const keys = {
      ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1],
      "+": [0, 0, 1.15], "-": [0, 0, 1 / 1.15],
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.key in keys) {
        event.preventDefault();
        this.#turn(...keys[event.key]);
      }
    });
  }

  /* One pointer turns; the distance of two zooms. */
  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const others = [...this.pointers.values()].filter((p) => p.pointerId !== event.pointerId);
    this.pointers.set(event.pointerId, event);
    if (others.length) {
      const distance = (p) => Math.hypot(p.clientX - others[0].clientX, p.clientY - others[0].clientY);
      this.#turn(0, 0, distance(event) / Math.max(distance(before), 1));
    } else {
      this.#turn(0.008 * (event.clientX - before.clientX), 0.008 * (event.clientY - before.clientY), 1);
    }
  }

  #turn(azimuth, elevation, zoom) {
    this.azimuth -= azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -Math.PI / 2), Math.PI / 2);
    this.zoom = Math.min(Math.max(this.zoom * zoom, 0.2), 50);
    this.draw();
  }

  draw() {
    const { canvas } = this, box = canvas.getBoundingClientRect(), scale = window.devicePixelRatio || 1;
    if (!box.width) return;
    canvas.width = Math.round(box.width * scale);
    canvas.height = Math.round(box.height * scale);
    const context = canvas.getContext("2d");
    context.setTransform(scale, 0, 0, scale, canvas.width / 2, canvas.height / 2);
    context.lineJoin = "round";
    const style = getComputedStyle(canvas);
    const project = this.#projection(Math.min(box.width, 1.4 * box.height));
    this.#drawGround(context, project, style);
    this.layers.forEach((layer, i) => {
      if (!this.shown[i]) return;
      context.strokeStyle = context.fillStyle = style.getPropertyValue(layer.color);
      (layer.shape === "line" ? drawLine : drawDots)(context, layer, project);
    });
  }

  /* From millimetres to [x, y, nearness]; a mild perspective, nearness about 1. */
  #projection(size) {
    const [sa, ca] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    const [se, ce] = [Math.sin(this.elevation), Math.cos(this.elevation)];
    const [cx, cy, cz] = this.centre, unit = (0.56 * size * this.zoom) / this.radius;
    const distance = 4 * this.radius;
    return (x, y, z) => {
      const right = (x - cx) * ca + (y - cy) * sa, away = (y - cy) * ca - (x - cx) * sa;
      const up = (z - cz) * ce + away * se, depth = away * ce - (z - cz) * se;
      const near = distance / Math.max(distance + depth, 0.1 * distance);
      return [right * unit * near, -up * unit * near, near];
    };
  }

  /* Squares of a round number of metres on the ground, and the axes from the world's origin. */
  #drawGround(context, project, style) {
    const step = roundDown(this.radius / 2.5), [cx, cy] = this.centre, z = this.floor;
    const from = (c) => Math.floor((c - this.radius) / step) * step;
    const to = (c) => Math.ceil((c + this.radius) / step) * step;
    context.strokeStyle = style.getPropertyValue("--grid");
    context.lineWidth = 1;
    context.setLineDash([]);
    const line = (a, b) => {
      context.beginPath();
      context.moveTo(...project(...a).slice(0, 2));
      context.lineTo(...project(...b).slice(0, 2));
      context.stroke();
    };
    for (let x = from(cx); x <= to(cx); x += step) line([x, from(cy), z], [x, to(cy), z]);
    for (let y = from(cy); y <= to(cy); y += step) line([from(cx), y, z], [to(cx), y, z]);
    context.strokeStyle = context.fillStyle = style.getPropertyValue("--soft");
    context.font = `12px ${style.fontFamily}`;
    for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
      const end = axis.map((value) => value * step);
      line([0, 0, 0], end);
      const [u, v] = project(...end.map((value) => 1.12 * value));
      context.fillText(name, u - 3, v + 4);
    }
    const { width, height } = this.canvas.getBoundingClientRect();
    context.fillText(`squares of ${step / 1000} m`, 10 - width / 2, height / 2 - 10);
  }
}

function drawLine(context, { dashed, mm }, project) {
  context.lineWidth = dashed ? 1.4 : 2;
  context.setLineDash(dashed ? [6, 4] : []);
  context.beginPath();
  for (let i = 0; i < mm.length; i += 3) {
    const [u, v] = project(mm[i], mm[i + 1], mm[i + 2]);
    i ? context.lineTo(u, v) : context.moveTo(u, v);
  }
  context.stroke();
  context.setLineDash([]);
  if (dashed || !mm.length) return;
  const [u, v] = project(...mm.slice(-3));
  context.fillRect(u - 4, v - 4, 8, 8); // where it ends
}

function drawDots(context, { mm }, project) {
  const size = Math.min(Math.max(60 / Math.sqrt(mm.length / 3), 1.2), 4);
  for (let i = 0; i < mm.length; i += 3) {
    const [u, v, near] = project(mm[i], mm[i + 1], mm[i + 2]);
    context.fillRect(u - (size * near) / 2, v - (size * near) / 2, size * near, size * near);
  }
}

/* The next of 1, 2, 5, 10, 20, .. downwards. */
function roundDown(value) {
  const ten = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].find((factor) => factor * ten <= value) * ten;
}

