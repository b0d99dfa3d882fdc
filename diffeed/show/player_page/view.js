// ---- view: which part of the machine is on the canvas, and how hands move it ----

class View {
  constructor(canvas, extent, changed) {
    Object.assign(this, { canvas, extent, changed, pointers: new Map(), x: 0, y: 0, scale: 1, fitted: true });
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("dblclick", () => this.fit());
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ratio = ratio;
    if (this.fitted) this.fit(); else this.changed();
  }

  fit() {
    const [left, bottom, right, top] = this.extent, margin = 34;
    const across = (this.width - 2 * margin) / Math.max(right - left, 1e-6);
    const up = (this.height - 2 * margin - 34) / Math.max(top - bottom, 1e-6);
    this.scale = Math.max(Math.min(across, up), 1e-3);
    this.x = 0.5 * (left + right);
    this.y = 0.5 * (bottom + top) - 17 / this.scale;
    this.fitted = true;
    this.changed();
  }

  toPage(x, y) { return [(x - this.x) * this.scale + this.width / 2, (this.y - y) * this.scale + this.height / 2]; }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const scale = Math.min(Math.max(this.scale * factor, 0.05), 5000), gain = 1 / this.scale - 1 / scale;
    this.x += (px - this.width / 2) * gain;
    this.y -= (py - this.height / 2) * gain;
    this.scale = scale;
    this.fitted = false;
    this.changed();
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.fitted = false;
    this.changed();
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    this.zoom(Math.exp(-0.0015 * lines * event.deltaY), event.offsetX, event.offsetY);
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
  }

  drag(event) {
    const last = this.pointers.get(event.pointerId);
    if (last === undefined) return;
    const here = [event.offsetX, event.offsetY];
    if (this.pointers.size === 1) this.pan(here[0] - last[0], here[1] - last[1]);
    if (this.pointers.size === 2) this.pinch(event.pointerId, last, here);
    this.pointers.set(event.pointerId, here);
  }

  pinch(id, last, here) {
    const other = [...this.pointers].find(([key]) => key !== id)[1];
    const distance = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
    const middle = (p, k) => 0.5 * (p[k] + other[k]);
    this.pan(middle(here, 0) - middle(last, 0), middle(here, 1) - middle(last, 1));
    this.zoom(distance(here) / Math.max(distance(last), 1), middle(here, 0), middle(here, 1));
  }
}
