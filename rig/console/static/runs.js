// Starts a run after showing its dry run; and the list of the runs in the folder of this console, with the pages in the run folders, and with
// pages made from several runs: comparisons and trends.

const at = (id) => document.getElementById(id);
const AFTER_MS = 4000; // between two lists after a run has ended: a verdict may follow
const AFTER_FOR_MS = 300000;
const ELSE_MS = 60000;
const LEAST = 2; // runs of a comparison
const MOST = 6;
const KEPT = 5; // links to pages that were made

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
  constructor(going, shown, link) {
    this.list = null;
    this.link = link;
    this.may = false;
    this.making = false;
    this.chosen = new Set();
    this.going = going;
    this.shown = shown;
    this.read = -Infinity;
    this.ended = -Infinity;
    this.was = false;
    at("recorded-again").addEventListener("click", () => this.take());
    for (const id of ["recorded-bench", "recorded-last"]) {
      at(id).addEventListener("change", () => this.take());
    }
    at("recorded").addEventListener("change", (event) => this.choose(event.target));
    // While a run is in progress, the space bar is STOP; a checkbox is then changed with Enter.
    at("recorded").addEventListener("keydown", (event) => {
      if (event.key === "Enter" && event.target.type === "checkbox") event.target.click();
    });
    at("compare").addEventListener("click", () => this.make("/compare", { runs: [...this.chosen] }));
    at("trend").addEventListener("click", () =>
      this.make("/trend", { constant: at("constant").value, ...this.choice() }));
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
    const { root, count, problem, runs, benches, constants } = this.list;
    const more = count > runs.length ? `, ${runs.length} of which are listed` : "";
    at("recorded-words").textContent = problem
      || `${count} ${count === 1 ? "run" : "runs"} in ${root}${more}; \`rig runs list\` lists all runs.`;
    choose(at("recorded-bench"), [new Option("every bench", "")], benches);
    choose(at("constant"), constants.length ? [] : [new Option("none known", "")], constants);
    const listed = new Set(runs.filter((run) => run.comparable).map((run) => run.folder));
    for (const folder of this.chosen) if (!listed.has(folder)) this.chosen.delete(folder);
    const rows = runs.map((run) => this.row(run));
    // While a link or a checkbox has the focus, the list is kept, because a new list has no focus.
    if (!at("recorded").contains(document.activeElement)) at("recorded").replaceChildren(...rows);
    this.showButtons();
    this.shown();
  }

  choose(box) {
    if (box.checked) this.chosen.add(box.value);
    else this.chosen.delete(box.value);
    this.showButtons();
  }

  // Whether this page may request comparisons and trends: only with the token (processor time).
  allow(may) {
    this.may = may;
    this.showButtons();
  }

  showButtons() {
    const count = this.chosen.size;
    const on = this.may && !this.making;
    at("compare").disabled = !on || count < LEAST || count > MOST;
    at("trend").disabled = !on || !at("constant").value;
    const words = this.may ? `${count} runs chosen. Choose ${LEAST} to ${MOST} runs. ${this.compared()}`
      : "Read only: without the token, no comparisons and trends are made, because they take processor time.";
    if (at("chosen-words").textContent !== words) at("chosen-words").textContent = words;
  }

  // States what a comparison of the chosen runs contains, and which identification is missing.
  compared() {
    const bare = (this.list?.runs || []).filter((run) => this.chosen.has(run.folder) && !run.identified);
    const without = bare.length
      ? ` Not identified, so compared without constants: ${bare.map((run) => run.folder).join(", ")}; \`rig identify RUN\` at a terminal identifies a run.` : "";
    const trend = this.list && !this.list.constants.length
      ? " No listed run is identified, so there is no constant to follow." : "";
    return `Measured values are compared side by side, constants with those of the earliest identified run.${without}${trend}`;
  }

  async make(path, content) {
    this.making = true;
    this.showButtons();
    at("made-words").textContent = "The console is making the page.";
    const answer = await this.link.post(path, content);
    this.making = false;
    this.showButtons();
    if (!answer.ok) {
      at("made-words").textContent = `The page was not made: ${answer.words}`;
      return;
    }
    at("made-words").textContent = "The page is ready; open it below.";
    const link = document.createElement("a");
    link.href = answer.page;
    link.target = "_blank";
    link.rel = "noopener";
    link.textContent = answer.words;
    const line = document.createElement("li");
    line.append(link);
    at("made").prepend(line);
    while (at("made").children.length > KEPT) at("made").lastChild.remove();
  }

  row(run) {
    const line = document.createElement("tr");
    line.append(this.box(run));
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

  // A checkbox for a run that is complete enough to be compared.
  box(run) {
    const cell = document.createElement("td");
    if (!run.comparable) {
      cell.textContent = "-";
      return cell;
    }
    const label = document.createElement("label");
    const box = document.createElement("input");
    label.className = "box";
    box.type = "checkbox";
    box.value = run.folder;
    box.checked = this.chosen.has(run.folder);
    box.setAttribute("aria-label", `Compare ${run.folder}`);
    label.append(box);
    cell.append(label);
    return cell;
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

export function setUpStart(link, say, started) {
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
      say(`Refused: ${answer.words}`);
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
  at("start").addEventListener("click", async () => {
    const answer = await link.post("/start", { shown, typed_bench: at("typed-bench").value });
    if (!answer.ok) {
      say(`Refused: ${answer.words}`);
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
