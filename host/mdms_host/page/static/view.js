// Which part of the table the canvas shows: metres of the table frame to pixels and back.

/** Beside the table the name of an exit takes so much [pixels]. */
const NAME_PX = 22;

export class View {
  constructor() {
    this.scale = 500;
    this.x = 0;
    this.y = 0;
    this.width = this.height = 1;
    this.fitted = true;
  }

  resize(width, height) {
    this.width = width;
    this.height = height;
    if (this.fitted && this.table) this.fit(this.table);
  }

  /** Shows a whole table, with room for tools and legend. */
  fit(table) {
    this.table = table;
    const wide = (table.columns + 0.5) * table.pitch_m, high = (table.rows + 0.5) * table.pitch_m;
    const room = this.width > 700 ? 60 : 88, beside = (x, y) => table.exits.some(({ out }) => out[0] === x && out[1] === y) ? NAME_PX : 0;
    const [east, west, north, south] = [beside(1, 0), beside(-1, 0), beside(0, 1), beside(0, -1)];
    this.scale = Math.max(20, Math.min((this.width - 24 - east - west) / wide, (this.height - 2 * room - north - south) / high));
    this.x = (east - west) / 2 / this.scale;
    this.y = (north - south) / 2 / this.scale;
    this.fitted = true;
  }

  px(x) { return this.width / 2 + (x - this.x) * this.scale; }
  py(y) { return this.height / 2 - (y - this.y) * this.scale; }
  at(px, py) {
    return [(px - this.width / 2) / this.scale + this.x, (this.height / 2 - py) / this.scale + this.y];
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.at(px, py);
    this.scale = Math.max(20, Math.min(20000, this.scale * factor));
    const [after_x, after_y] = this.at(px, py);
    this.pan(x - after_x, y - after_y);
  }

  pan(x, y) {
    this.x += x;
    this.y += y;
    this.fitted = false;
  }

  get signature() { return `${this.scale} ${this.x} ${this.y} ${this.width} ${this.height}`; }
}
