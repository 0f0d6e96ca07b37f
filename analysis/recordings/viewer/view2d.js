// The flight from above on a plain canvas: where there is no WebGL, and nothing else is needed.

import { focus, inAir, thrown } from "formctl/flight";

export class View2D {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    this.pen = canvas.getContext("2d");
    this.cameras = ["top"];
  }

  setCamera() {}

  draw(time) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (this.canvas.width !== width * ratio || this.canvas.height !== height * ratio) {
      this.canvas.width = width * ratio;
      this.canvas.height = height * ratio;
    }
    const { pen } = this;
    const scale = Math.min(width / 16, height / 6.5);
    const middle = focus(this.data, time)[1] + 2;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = "#eef1f5";
    pen.fillRect(0, 0, width, height);
    // The course runs to the right; lateral x grows downwards, to the right of the flight.
    const dot = (x, y) => [width / 2 + (y - middle) * scale, height / 2 + x * scale];
    this.ground(dot, middle, width / scale / 2);
    for (const method of this.data.methods) if (method.visible) this.method(method, time, dot, scale);
  }

  ground(dot, middle, half) {
    const { pen, data } = this;
    pen.lineWidth = 1;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    for (let y = Math.ceil(middle - half); y <= middle + half; y++) {
      pen.strokeStyle = y % 5 ? "#dde1e7" : "#c3c9d2";
      this.line([dot(-4, y), dot(4, y)]);
      pen.fillStyle = "#5d6169";
      if (y % 5 === 0) pen.fillText(`${y} m`, ...dot(3.9, y));
    }
    for (let x = -3; x <= 3; x++) {
      pen.strokeStyle = "#dde1e7";
      this.line([dot(x, middle - half), dot(x, middle + half)]);
    }
    pen.strokeStyle = "#1c1d20";
    pen.lineWidth = 2;
    this.line([dot(-4, data.scene.goal), dot(4, data.scene.goal)]);
    pen.fillStyle = "#1c1d20";
    pen.fillText("goal", ...dot(-4.1, data.scene.goal));
    const radius = data.scene.column_radius * (dot(0, 1)[0] - dot(0, 0)[0]);
    for (const [x, y] of data.scene.columns) this.circle(dot(x, y), radius, "#6b7079");
  }

  method(method, time, dot, scale) {
    const { pen, data } = this;
    const places = [];
    const [last] = method.at(time);
    for (let drone = 0; drone < method.drones; drone++) {
      const path = [];
      for (let sample = 0; sample <= last; sample += 2) path.push(dot(...method.place(drone, 0, sample)));
      const here = dot(...method.place(drone, time));
      places.push(here);
      pen.strokeStyle = method.colours[drone];
      pen.lineWidth = 2;
      pen.globalAlpha = 0.55;
      this.line([...path, here]);
      pen.globalAlpha = 1;
    }
    pen.strokeStyle = "#8a8f98";
    pen.lineWidth = 1;
    this.line([...places, places[0]]);
    for (const throw_ of method.throws) {
      if (!inAir(throw_, time)) continue;
      pen.setLineDash([6, 4]);
      pen.strokeStyle = "#B2182B";
      this.line([dot(...throw_.origin), dot(...thrown(throw_, throw_.landing))]);
      pen.setLineDash([]);
      this.circle(dot(...thrown(throw_, time)), data.scene.ball_radius * scale, "#B2182B");
    }
    places.forEach((here, drone) => {
      const hit = method.hit(drone, time);
      this.circle(here, Math.max(5, 0.13 * scale), hit ? "#d7191c" : method.colours[drone]);
      if (hit) {
        pen.strokeStyle = "#d7191c";
        pen.lineWidth = 3;
        pen.beginPath();
        pen.arc(...here, 0.3 * scale, 0, 7);
        pen.stroke();
      }
    });
  }

  line(points) {
    this.pen.beginPath();
    points.forEach(([x, y], k) => (k ? this.pen.lineTo(x, y) : this.pen.moveTo(x, y)));
    this.pen.stroke();
  }

  circle([x, y], radius, fill) {
    this.pen.beginPath();
    this.pen.arc(x, y, radius, 0, 7);
    this.pen.fillStyle = fill;
    this.pen.fill();
  }
}
