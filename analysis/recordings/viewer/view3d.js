// The flight in space, drawn by three.js. World axes as recorded: z up, flight along +y.

import * as THREE from "three";
import { OrbitControls } from "three/orbit";
import { focus, inAir, thrown } from "formctl/flight";

const SKY = 0xe8edf3;
const HIT = 0xd7191c;
const RED = 0xb2182b;
const COLUMN_HEIGHT = 3;
const DRAWN = 2.2; // drones are drawn larger than they are
const SIDES = 6; // of a trail's tube

export class View3D {
  constructor(canvas, data) {
    this.data = data;
    this.canvas = canvas;
    this.cameras = ["follow", "top", "free"];
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    this.scene.fog = new THREE.Fog(SKY, 30, 75);
    this.camera = new THREE.PerspectiveCamera(45, 1, 0.1, 200);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enabled = false;
    this.controls.maxDistance = 60;
    this.surroundings();
    this.methods = data.methods.map((method) => this.method(method));
    this.setCamera("follow");
  }

  setCamera(name) {
    const before = this.name;
    this.name = name;
    this.controls.enabled = name === "free";
    this.camera.up.set(...(name === "top" ? [-1, 0, 0] : [0, 0, 1])); // from the top the course runs to the right
    this.camera.fov = name === "top" ? 20 : 45;
    this.camera.updateProjectionMatrix();
    if (name === "free" && before && before !== "free") {
      const centre = focus(this.data, this.time || 0);
      if (before === "top") this.camera.position.set(centre[0] + 5, centre[1] - 7, 5);
      this.controls.object = this.camera;
      this.controls.dispose();
      this.controls = new OrbitControls(this.camera, this.canvas);
      this.controls.target.set(...centre);
      this.controls.maxDistance = 60;
    }
  }

  surroundings() {
    const { scene, data } = this;
    scene.add(new THREE.HemisphereLight(0xffffff, 0xb8bcc4, 2.4));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(-4, -6, 12);
    scene.add(sun);
    const ground = new THREE.Mesh(new THREE.PlaneGeometry(120, 160), new THREE.MeshBasicMaterial({ color: 0xdfe3e8 }));
    ground.position.set(0, data.scene.goal / 2, -0.01);
    scene.add(ground);
    const lines = [];
    for (let x = -6; x <= 6; x++) // in pieces: software renderers drop lines that pass behind the camera
      for (let y = -4; y < data.scene.goal + 12; y += 2) lines.push(x, y, 0, x, y + 2, 0);
    for (let y = -4; y <= data.scene.goal + 12; y++) lines.push(-6, y, 0, 6, y, 0);
    const grid = new THREE.BufferGeometry();
    grid.setAttribute("position", new THREE.Float32BufferAttribute(lines, 3));
    scene.add(new THREE.LineSegments(grid, new THREE.LineBasicMaterial({ color: 0xc5cad2 })));
    const goal = new THREE.Mesh(new THREE.PlaneGeometry(12, 0.12), new THREE.MeshBasicMaterial({ color: 0x1c1d20 }));
    goal.position.set(0, data.scene.goal, 0.005);
    scene.add(goal);
    const radius = data.scene.column_radius;
    const shape = new THREE.CylinderGeometry(radius, radius, COLUMN_HEIGHT, 28);
    this.columns = data.scene.columns.map(([x, y]) => {
      const column = new THREE.Mesh(shape, new THREE.MeshLambertMaterial({ color: 0x7b818b, transparent: true }));
      column.rotation.x = Math.PI / 2;
      column.position.set(x, y, COLUMN_HEIGHT / 2);
      scene.add(column);
      return column;
    });
  }

  method(method) {
    const group = new THREE.Group();
    this.scene.add(group);
    const drones = method.colours.map((colour) => this.drone(group, colour));
    const trails = method.colours.map((colour, drone) => this.trail(group, method, drone, colour));
    const edges = new THREE.LineLoop(
      new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(new Float32Array(3 * method.drones), 3)),
      new THREE.LineBasicMaterial({ color: method.colour, transparent: true, opacity: 0.7 }),
    );
    edges.frustumCulled = false;
    group.add(edges);
    const ball = new THREE.SphereGeometry(this.data.scene.ball_radius, 24, 16);
    const balls = method.throws.map((throw_) => {
      const sphere = new THREE.Mesh(ball, new THREE.MeshLambertMaterial({ color: RED }));
      const points = Array.from({ length: 33 }, (_, k) => new THREE.Vector3(...thrown(throw_, throw_.time + ((throw_.landing - throw_.time) * k) / 32)));
      const dashes = new THREE.LineDashedMaterial({ color: method.drones && this.data.methods.length > 1 ? method.colour : RED, dashSize: 0.18, gapSize: 0.1 });
      const arc = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), dashes);
      arc.computeLineDistances();
      group.add(sphere, arc);
      return { throw_, sphere, arc };
    });
    const flags = method.hits.map((event) => {
      const flag = new THREE.Mesh(new THREE.TorusGeometry(0.32, 0.035, 10, 40), new THREE.MeshBasicMaterial({ color: HIT }));
      flag.position.set(...method.place(event.drone, event.time));
      group.add(flag);
      return { event, flag };
    });
    const plans = new THREE.Group();
    group.add(plans);
    return { method, group, drones, trails, edges, balls, flags, plans };
  }

  drone(group, colour) {
    const body = new THREE.Group();
    const paint = new THREE.MeshLambertMaterial({ color: colour });
    const dark = new THREE.MeshLambertMaterial({ color: 0x30333a });
    const rotor = new THREE.CylinderGeometry(0.026, 0.026, 0.006, 20);
    const arm = new THREE.BoxGeometry(0.112, 0.009, 0.006);
    body.add(new THREE.Mesh(new THREE.BoxGeometry(0.04, 0.034, 0.018), paint));
    for (const turn of [1, 3]) {
      const bar = new THREE.Mesh(arm, dark);
      bar.rotation.z = (turn * Math.PI) / 4;
      body.add(bar);
    }
    for (const [x, y] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      const disc = new THREE.Mesh(rotor, paint);
      disc.rotation.x = Math.PI / 2;
      disc.position.set(x * 0.0396, y * 0.0396, 0.012);
      body.add(disc);
    }
    body.scale.setScalar(DRAWN);
    group.add(body);
    return { body, paint, colour: new THREE.Color(colour) };
  }

  // A tube through the whole path, of which the part flown is shown.
  trail(group, method, drone, colour) {
    const points = [];
    for (let sample = 0; sample < method.samples; sample += 3) points.push(new THREE.Vector3(...method.place(drone, 0, sample)));
    const curve = new THREE.CatmullRomCurve3(points);
    curve.getPointAt = curve.getPoint; // by time, not by length: the part flown is a share of the time
    curve.getTangentAt = curve.getTangent;
    const tube = new THREE.TubeGeometry(curve, points.length - 1, 0.016, SIDES);
    const mesh = new THREE.Mesh(tube, new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.65 }));
    group.add(mesh);
    return { tube, segments: points.length - 1, duration: (method.samples - 1) * method.period };
  }

  draw(time) {
    this.time = time;
    this.resize();
    for (const shown of this.methods) this.update(shown, time);
    this.aim(time);
    this.renderer.render(this.scene, this.camera);
  }

  update({ method, group, drones, trails, edges, balls, flags, plans }, time) {
    group.visible = method.visible;
    if (!method.visible) return;
    drones.forEach(({ body, paint, colour }, drone) => {
      body.position.set(...method.place(drone, time));
      body.quaternion.set(...method.turn(drone, time));
      if (method.hit(drone, time)) paint.color.setHex(HIT);
      else paint.color.copy(colour);
      edges.geometry.attributes.position.setXYZ(drone, ...method.place(drone, time));
    });
    edges.geometry.attributes.position.needsUpdate = true;
    for (const { tube, segments, duration } of trails) tube.setDrawRange(0, 6 * SIDES * Math.floor((segments * Math.min(time, duration)) / duration));
    for (const { throw_, sphere, arc } of balls) {
      sphere.visible = inAir(throw_, time);
      arc.visible = time >= throw_.time && time < throw_.landing + 1.5;
      sphere.position.set(...thrown(throw_, time));
    }
    for (const { event, flag } of flags) {
      flag.visible = time >= event.time;
      flag.quaternion.copy(this.camera.quaternion);
    }
    plans.clear();
    for (const plan of method.plansAt(time)) {
      const points = plan.points.map((point) => new THREE.Vector3(...point.slice(1)));
      plans.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: method.colours[plan.drone] })));
    }
  }

  aim(time) {
    const [x, y] = focus(this.data, time);
    for (const column of this.columns) {
      const between = this.name === "follow" && column.position.y < y - 0.2; // it would hide the drones
      column.material.opacity = between ? 0.22 : 1;
      column.material.depthWrite = !between;
    }
    if (this.name === "follow") {
      this.camera.position.set(x + 2.2, y - 6.2, 4.6);
      this.camera.lookAt(x * 0.6, y + 2.2, 1.1);
    } else if (this.name === "top") {
      this.camera.position.set(0, y + 2, 30);
      this.camera.lookAt(0, y + 2, 0);
    } else this.controls.update();
  }

  resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (this.width === width && this.height === height) return;
    [this.width, this.height] = [width, height];
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
  }
}
