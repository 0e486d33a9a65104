// Starts a run after showing its dry run.

const at = (id) => document.getElementById(id);

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
