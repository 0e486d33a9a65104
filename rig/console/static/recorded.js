// The runs in the folder of this console, with the pages that lie in their folders.

const at = (id) => document.getElementById(id);
const AFTER_MS = 4000; // between two lists after a run has ended: a verdict may follow
const AFTER_FOR_MS = 300000;
const ELSE_MS = 60000;

export class Recorded {
  // `going` tells whether a run goes on: then the list is read only when it is asked for.
  constructor(going, shown) {
    this.list = null;
    this.going = going;
    this.shown = shown;
    this.read = -Infinity;
    this.ended = -Infinity;
    this.was = false;
    at("recorded-again").addEventListener("click", () => this.take());
    setInterval(() => this.watch(), 1000);
  }

  watch() {
    const going = this.going();
    const now = performance.now();
    if (this.was && !going) this.ended = now;
    this.was = going;
    if (going && this.list || document.hidden) return;
    const often = now - this.ended < AFTER_FOR_MS;
    if (now - this.read >= (often ? AFTER_MS : ELSE_MS)) this.take();
  }

  async take() {
    this.read = performance.now();
    try {
      const answer = await fetch("/recorded", { cache: "no-store", credentials: "omit" });
      if (!answer.ok) throw new Error(answer.statusText);
      this.list = await answer.json();
    } catch (error) {
      at("recorded-words").textContent = "The list could not be read.";
      return;
    }
    const { root, count, problem, runs } = this.list;
    const more = count > runs.length ? `, the latest ${runs.length} of which are shown` : "";
    at("recorded-words").textContent = problem
      || `${count} ${count === 1 ? "run" : "runs"} in ${root}${more}; \`rig runs list\` chooses among all.`;
    const rows = runs.map((run) => this.row(run));
    // Not while a link has the focus: it would be lost.
    if (!at("recorded").contains(document.activeElement)) at("recorded").replaceChildren(...rows);
    this.shown();
  }

  row(run) {
    const line = document.createElement("tr");
    const state = run.problem ? `${run.state}: ${run.problem}` : run.state;
    const cells = [run.folder, run.begun || "-", run.bench || "-", run.sequence || "-",
      run.operator, run.masses, state, run.verdict];
    cells.forEach((words, i) => {
      const cell = document.createElement(i ? "td" : "th");
      if (!i) cell.scope = "row";
      cell.textContent = words;
      line.append(cell);
    });
    const pages = document.createElement("td");
    pages.append(...this.links(run));
    line.append(pages);
    return line;
  }

  links(run) {
    const folder = run.folder === "." ? "" : run.folder.split("/").map(encodeURIComponent).join("/");
    return run.pages.flatMap(([name, words], i) => {
      const link = document.createElement("a");
      link.href = `/recorded/${folder}/${name}`;
      link.target = "_blank";
      link.rel = "noopener";
      link.textContent = words;
      return i ? [", ", link] : [link];
    });
  }

  // Returns the run of a folder, or null.
  of(folder) {
    const found = this.list?.runs.find((run) => `${this.list.root}/${run.folder}` === folder);
    return found || null;
  }
}
