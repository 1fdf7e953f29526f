// The last minute of snapshots, or a whole recorded run: what the plots are drawn from.

const PER_S = 20;
const KEPT_S = 60;

export class History {
  constructor() {
    this.snapshots = [];
    this.whole = false;
  }

  clear() {
    this.snapshots = [];
    this.whole = false;
  }

  /** Keeps a snapshot, unless it is too near to the last one. */
  add(snapshot) {
    if (this.whole) return;
    const kept = this.snapshots, time = snapshot.time[0];
    const last = kept.length ? kept[kept.length - 1].time[0] : -Infinity;
    if (time < last) this.snapshots = [];
    else if (time - last < 0.9 / PER_S) {
      return;
    }
    this.snapshots.push(snapshot);
    if (this.snapshots.length > PER_S * KEPT_S + 100) {
      this.snapshots = this.snapshots.filter((one) => one.time[0] > time - KEPT_S);
    }
  }

  /** Takes all snapshots of a recorded run. */
  fill(snapshots) {
    this.snapshots = snapshots;
    this.whole = true;
  }

  get times() { return this.snapshots.map((one) => one.time[0]); }
  series(value) {
    return this.snapshots.map((one) => {
      const number = value(one);
      return Number.isFinite(number) ? number : null;
    });
  }
}
