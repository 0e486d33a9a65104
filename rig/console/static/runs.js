// Starts a run after showing its dry run; and the list of the runs in the folder of this
// console, with the pages in the run folders.

import { failure } from "./link.js";

const at = (id) => document.getElementById(id);
const AFTER_MS = 4000; // between two lists after a run has ended: a verdict may follow
const AFTER_FOR_MS = 300000;
const ELSE_MS = 60000;

function choose(select, first, names) {
  const wanted = select.value;
  const options = [...first, ...names.map((name) => new Option(name, name))];
  const known = [...select.options].map((option) => option.value);
  if (options.length === known.length && options.every((each, i) => each.value === known[i])) return;
  select.replaceChildren(...options);
  if (options.some((option) => option.value === wanted)) select.value = wanted;
}

export class Recorded {
  // `going`: whether a run is in progress; the list is then read only on request of the user.
  constructor(going, shown) {
    this.list = null;
    this.going = going;
    this.shown = shown;
    this.read = -Infinity;
    this.ended = -Infinity;
    this.was = false;
    at("recorded-again").addEventListener("click", () => this.take());
    for (const id of ["recorded-bench", "recorded-last"]) {
      at(id).addEventListener("change", () => this.take());
    }
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

  choice() {
    return { bench: at("recorded-bench").value, last: Number(at("recorded-last").value) };
  }

  async take() {
    this.read = performance.now();
    const query = new URLSearchParams(this.choice());
    try {
      const answer = await fetch(`/recorded?${query}`, { cache: "no-store", credentials: "omit" });
      if (!answer.ok) throw new Error(answer.statusText);
      const list = await answer.json();
      // The answer to an earlier choice may arrive after the answer to the latest choice.
      if (`${query}` !== `${new URLSearchParams(this.choice())}`) return;
      this.list = list;
    } catch (error) {
      at("recorded-words").textContent = "The list could not be read.";
      return;
    }
    const { root, count, problem, runs, benches } = this.list;
    const more = count > runs.length ? `, ${runs.length} of which are listed` : "";
    at("recorded-words").textContent = problem
      || `${count} ${count === 1 ? "run" : "runs"} in ${root}${more}; \`rig runs list\` lists all runs.`;
    choose(at("recorded-bench"), [new Option("every bench", "")], benches);
    const rows = runs.map((run) => this.row(run));
    // While a link has the focus, the list is kept, because a new list has no focus.
    if (!at("recorded").contains(document.activeElement)) at("recorded").replaceChildren(...rows);
    this.shown();
  }

  row(run) {
    const line = document.createElement("tr");
    const [state, verdict] = run.cells.slice(-2);
    const cells = [run.folder, ...run.cells.slice(0, -2),
      run.problem ? `${state}: ${run.problem}` : state, verdict];
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
    const folder = run.folder === "." ? "" : run.folder.toWellFormed().split("/").map(encodeURIComponent).join("/");
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

export function setUpStart(link, say, started, fresh) {
  let shown = null;

  function fill(select, names) {
    const before = select.value;
    select.replaceChildren(...names.map((name) => new Option(name, name)));
    if (names.includes(before)) select.value = before;
  }

  function hide() {
    shown = null;
    at("dry").hidden = true;
  }

  at("start-form").addEventListener("input", hide);
  at("start-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    hide();
    at("dry-run").disabled = true;
    say("The console computes the dry run");
    const answer = await link.post("/dry-run", {
      bench: at("start-bench").value,
      sequence: at("start-own").value.trim() || at("start-sequence").value,
      operator: at("start-operator").value.trim(),
      realtime: at("start-realtime").checked,
      yes: at("start-yes").checked,
      acceptance: at("start-acceptance").value.trim(),
    });
    at("dry-run").disabled = false;
    if (!answer.ok) {
      say(failure(answer));
      return;
    }
    say("The dry run is shown under `Start a run`");
    shown = answer.shown;
    at("dry").hidden = false;
    at("dry-words").textContent = answer.words;
    at("dry-verdict").textContent = answer.status === 0 ? "The dry run found no problem."
      : answer.status === 1 ? "The dry run found problems: read the problems before you start the run."
        : "This run cannot be started.";
    at("dry-real").hidden = !answer.real;
    at("typed-bench").value = "";
    at("start").hidden = !shown;
    at("start").textContent = answer.real ? `Start this run on the REAL bench ${answer.bench}`
      : "Start this run on the simulated bench";
    at("dry").scrollIntoView({ block: "nearest" });
  });
  at("start").addEventListener("click", async (event) => {
    if (!fresh(event)) return;
    const answer = await link.post("/start", { shown, typed_bench: at("typed-bench").value });
    if (!answer.ok) {
      say(failure(answer));
      return;
    }
    hide();
    started(answer.words);
    scrollTo({ top: 0 });
  });

  return {
    choices(choices) {
      fill(at("start-bench"), choices.benches);
      fill(at("start-sequence"), choices.sequences);
    },
    allow(may) {
      for (const node of at("start-form").elements) node.disabled = !may;
      at("start").disabled = !may;
    },
  };
}
