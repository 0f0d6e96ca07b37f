// Clock, controls and readouts. A fragment sets the start: #t=7.5&camera=top&view=2d&play

import { load } from "formctl/flight";
import { View2D } from "formctl/view2d";
import { View3D } from "formctl/view3d";

const find = (id) => document.getElementById(id);
const data = load(find("recording"));
const wish = new URLSearchParams(location.hash.slice(1));
const view = open();
const events = data.methods
  .flatMap((method) => method.events.map((event) => ({ ...event, method })))
  .sort((one, other) => one.time - other.time);
let time = Math.min(Number(wish.get("t")) || 0, data.duration);
let playing = wish.has("play") && !matchMedia("(prefers-reduced-motion: reduce)").matches;
let drawn = 0;

function open() {
  const canvas = find("view");
  if (wish.get("view") === "2d") return new View2D(canvas, data);
  try {
    return new View3D(canvas, data);
  } catch (error) {
    const fresh = canvas.cloneNode(); // a canvas that WebGL has touched gives no 2-D context
    canvas.replaceWith(fresh);
    find("notice").textContent = `Seen from above: there is no WebGL here for the view in space (${error.message}).`;
    find("notice").hidden = false;
    return new View2D(fresh, data);
  }
}

function describe() {
  find("where").textContent = data.scene.words;
  for (const method of data.methods) {
    const item = document.createElement("li");
    const label = document.createElement("label");
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = true;
    box.addEventListener("change", () => ((method.visible = box.checked), show()));
    const swatch = document.createElement("span");
    swatch.className = "swatch";
    swatch.setAttribute("aria-hidden", "true");
    for (const colour of new Set(method.colours)) swatch.append(Object.assign(document.createElement("i"), { style: `background:${colour}` }));
    label.append(box, swatch, method.name);
    const verdict = Object.assign(document.createElement("div"), { className: `verdict${method.success ? "" : " failed"}`, textContent: method.verdict });
    method.live = Object.assign(document.createElement("div"), { className: "live" });
    item.append(label, verdict, method.live);
    find("methods").append(item);
  }
  for (const event of events) {
    const words = `${event.time.toFixed(1)} s: ${event.text}${data.methods.length > 1 ? `, ${event.method.name}` : ""}`;
    const mark = Object.assign(document.createElement("button"), { className: event.kind, title: words, tabIndex: -1 });
    mark.setAttribute("aria-label", words);
    mark.style.left = `${(100 * event.time) / data.duration}%`;
    mark.addEventListener("click", () => seek(event.time));
    find("marks").append(mark);
  }
  find("seek").max = data.duration;
  for (const radio of document.querySelectorAll("[name=camera]")) {
    radio.disabled = !view.cameras.includes(radio.value);
    radio.checked = radio.value === view.cameras[0];
    radio.addEventListener("change", () => camera(radio.value));
  }
}

// Formation error of every method over time, the part flown in full colour.
function chart() {
  const canvas = find("chart");
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  const most = Math.max(0.5, ...data.methods.map((method) => Math.min(6, Math.max(...method.error))));
  for (const method of data.methods) {
    if (!method.visible) continue;
    for (const [until, alpha] of [[data.duration, 0.25], [time, 1]]) {
      pen.beginPath();
      for (let k = 0; k < method.error.length && k * method.period <= until; k++)
        pen.lineTo((width * k * method.period) / data.duration, height - 3 - (Math.min(method.error[k], most) / most) * (height - 16));
      pen.globalAlpha = alpha;
      pen.strokeStyle = method.colour;
      pen.lineWidth = 1.5;
      pen.stroke();
    }
  }
  pen.globalAlpha = 1;
  pen.fillStyle = "#5d6169";
  pen.font = "11px system-ui, sans-serif";
  pen.fillText(`formation error, up to ${most.toFixed(1)} m`, 14, 10);
  pen.fillStyle = "#1c1d20";
  pen.fillRect((width * time) / data.duration, 0, 1.5, height);
}

function show() {
  view.draw(time);
  chart();
  find("seek").value = time;
  find("seek").setAttribute("aria-valuetext", `${time.toFixed(1)} of ${data.duration.toFixed(1)} seconds`);
  find("clock").textContent = `${time.toFixed(2)} / ${data.duration.toFixed(0)} s`;
  find("play").textContent = playing ? "Pause" : "Play";
  for (const method of data.methods) {
    const near = method.number_at(method.nearest, time);
    const nearest = near === null ? "" : `, nearest obstacle ${near.toFixed(2)} m`;
    method.live.textContent = `${method.number_at(method.speed, time).toFixed(1)} m/s, formation error ${method.number_at(method.error, time).toFixed(2)} m${nearest}`;
  }
  const recent = events.filter((event) => event.method.visible && event.time <= time && time < event.time + 1.6).at(-1);
  const words = recent ? `${recent.text}${data.methods.length > 1 ? ` (${recent.method.name})` : ""}` : "";
  if (find("now").textContent !== words) find("now").textContent = words;
  find("now").className = recent && (recent.kind === "contact" || recent.kind === "late") ? "alarm" : "";
}

function seek(moment) {
  time = Math.min(Math.max(moment, 0), data.duration);
  show();
}

function toggle() {
  if (!playing && time >= data.duration) time = 0;
  playing = !playing;
  drawn = performance.now();
  show();
  if (playing) requestAnimationFrame(tick);
}

function tick(now) {
  if (!playing) return;
  time = Math.min(time + ((now - drawn) / 1000) * Number(find("speed").value), data.duration);
  drawn = now;
  if (time >= data.duration) playing = false;
  show();
  if (playing) requestAnimationFrame(tick);
}

function camera(name) {
  if (!view.cameras.includes(name)) return;
  document.querySelector(`[name=camera][value=${name}]`).checked = true;
  view.setCamera(name);
  show();
}

function faster(steps) {
  const select = find("speed");
  select.selectedIndex = Math.min(Math.max(select.selectedIndex + steps, 0), select.options.length - 1);
}

const toNext = () => seek((events.find((event) => event.time > time + 0.01) || { time: data.duration }).time);
const toPrevious = () => seek((events.findLast((event) => event.time < time - 0.01) || { time: 0 }).time);

function key(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const inside = event.target.tagName;
  const actions = {
    " ": () => toggle(),
    ArrowLeft: () => seek(time - (event.shiftKey ? 2 : 0.2)),
    ArrowRight: () => seek(time + (event.shiftKey ? 2 : 0.2)),
    Home: () => seek(0),
    End: () => seek(data.duration),
    1: () => camera("follow"),
    2: () => camera("top"),
    3: () => camera("free"),
    "+": () => faster(1),
    "=": () => faster(1),
    "-": () => faster(-1),
    n: () => toNext(),
    p: () => toPrevious(),
  };
  const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action || inside === "SELECT") return;
  if (event.key === " " && (inside === "BUTTON" || (inside === "INPUT" && event.target.type !== "range"))) return;
  if (event.key.startsWith("Arrow") && inside === "INPUT" && event.target.type === "radio") return;
  event.preventDefault();
  action();
}

describe();
find("play").addEventListener("click", toggle);
find("next").addEventListener("click", toNext);
find("seek").addEventListener("input", () => seek(Number(find("seek").value)));
addEventListener("keydown", key);
addEventListener("resize", show);
if (view.controls) view.canvas.addEventListener("pointermove", () => !playing && view.name === "free" && show());
if (view.controls) view.canvas.addEventListener("wheel", () => !playing && view.name === "free" && requestAnimationFrame(show), { passive: true });
show();
if (wish.has("camera")) camera(wish.get("camera"));
if (playing) ((drawn = performance.now()), requestAnimationFrame(tick));
document.documentElement.dataset.ready = view.constructor.name;
