// The recording behind the page: decoded once, asked for any moment.

const GRAVITY = 9.81;
const METHODS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00"];
const DRONES = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00"];

export class Method {
  constructor(entry, number, alone, scene) {
    Object.assign(this, entry);
    this.number = number;
    this.visible = true;
    this.period = scene.period;
    this.colour = METHODS[number % METHODS.length];
    this.colours = Array.from({ length: this.drones }, (_, k) => (alone ? DRONES[k % DRONES.length] : this.colour));
    this.places = Float32Array.from(this.position, (value) => value / 1000);
    this.turns = Float32Array.from(this.attitude, (value) => value / 1000);
    this.samples = this.places.length / (3 * this.drones);
    this.duration = (this.samples - 1) * this.period;
    this.hits = this.events.filter((event) => event.kind === "contact");
  }

  // Sample before `time`, and the share of the way to the next one.
  at(time) {
    const exact = Math.min(Math.max(time / this.period, 0), this.samples - 1);
    const first = Math.min(Math.floor(exact), this.samples - 2);
    return [first, exact - first];
  }

  place(drone, time, sample) {
    const [first, share] = sample === undefined ? this.at(time) : [sample, 0];
    const one = 3 * (first * this.drones + drone);
    const two = share ? one + 3 * this.drones : one;
    return [0, 1, 2].map((k) => this.places[one + k] * (1 - share) + this.places[two + k] * share);
  }

  // Attitude as x, y, z, w.
  turn(drone, time) {
    const [first] = this.at(time);
    const one = 4 * (first * this.drones + drone);
    return [this.turns[one + 1], this.turns[one + 2], this.turns[one + 3], this.turns[one]];
  }

  centre(time) {
    const sum = [0, 0, 0];
    for (let drone = 0; drone < this.drones; drone++) this.place(drone, time).forEach((value, k) => (sum[k] += value / this.drones));
    return sum;
  }

  hit(drone, time) {
    return this.hits.some((event) => event.drone === drone && event.time <= time);
  }

  plansAt(time) {
    const last = {};
    for (const plan of this.plans) if (plan.time <= time && time < plan.time + 1) last[plan.drone] = plan;
    return Object.values(last);
  }

  number_at(series, time) {
    return series[this.at(time)[0]];
  }
}

export function thrown(throw_, time) {
  const aloft = Math.min(time, throw_.landing) - throw_.time;
  return throw_.origin.map((value, k) => value + throw_.velocity[k] * aloft - (k === 2 ? (GRAVITY * aloft * aloft) / 2 : 0));
}

export function inAir(throw_, time) {
  return time >= throw_.time && time < throw_.landing;
}

export function load(element) {
  const data = JSON.parse(element.textContent);
  const alone = data.methods.length === 1;
  data.methods = data.methods.map((entry, number) => new Method(entry, number, alone, data.scene));
  data.duration = Math.max(...data.methods.map((method) => method.duration));
  return data;
}

// Smoothed centre of the visible methods: what the cameras look at.
export function focus(data, time) {
  const shown = data.methods.filter((method) => method.visible);
  const methods = shown.length ? shown : data.methods;
  const sum = [0, 0, 0];
  const moments = [-0.4, -0.2, 0, 0.2, 0.4];
  for (const method of methods)
    for (const shift of moments)
      method.centre(time + shift).forEach((value, k) => (sum[k] += value / methods.length / moments.length));
  return sum;
}
