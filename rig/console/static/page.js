// The page: shows the state of a run, and sends the operator's commands.

import { Charts, Friction } from "./charts.js";
import { failure, Link } from "./link.js";
import { Recorded, setUpStart } from "./runs.js";
import { activityWords, driveWords, headlineOf, PHASES, showTables, timeWords, whenWords } from "./words.js";

const FROZEN_MS = 2000; // a click that waited longer in a frozen page is not carried out
const AGAIN_MS = 400; // a second STOP within this time is the same press
const EVENTS = 200;
const TOLD = 6;

const at = (id) => document.getElementById(id);
const state = {};
let lastStop = -Infinity;
let said = {}; // the run that the line beside STOP refers to, and whether the line tells its end
let endDue = null; // key of the run in progress whose end is to be told beside STOP
let stopDue = []; // keys of the programs that this page has stopped, until their end is told
let answered = null; // prompt that this page answered, until its answer is known to be refused
let unconfirmed = null; // keys of the programs that have not confirmed STOP
let lostMs = 0; // time without contact with the console
let makingSafe = false;
let starting = false; // whether a run was started and is not found yet

const charts = new Charts(at("charts"), ask);
const friction = new Friction(at("friction"), at("friction-legend"), at("friction-words"));
const link = new Link(takeState, takeCharts, showContact);
const start = setUpStart(link, say, awaitRun, fresh);
const recorded = new Recorded(going, showJudged);

// Words about a run are removed when the page shows another run, and give way to what the run is
// doing when its phase changes.
function say(words, run = null, end = false) {
  at("outcome").textContent = words;
  said = { run, end, phase: phaseMark(), passing: run && !end };
}

function phaseMark() {
  return `${state.status?.phase}, prompt ${state.status?.prompt?.number}`;
}

function showActivity() {
  const words = activityWords(state.status);
  const replaced = !at("outcome").textContent || said.activity
    || (said.passing && said.phase !== phaseMark());
  if (!replaced || at("outcome").textContent === words) return;
  say(words, state.run);
  said.activity = true;
}

// A run was started or continued: the page waits until the console finds the run.
function awaitRun(words) {
  starting = true;
  say(words);
  said.passing = true;
  at("runs").value = "";
  ask();
}

// `alarm`: somebody must act at once.
function alertOnce(key, words, alarm = false) {
  const box = at("alerts");
  let line = box.querySelector(`[data-key="${key}"]`);
  if (!words) {
    line?.remove();
    return;
  }
  if (!line) {
    line = document.createElement("p");
    line.dataset.key = key;
    line.setAttribute("role", "alert");
    line.className = alarm ? "alarm" : "warning";
    if (alarm) box.prepend(line);
    else box.append(line);
  }
  if (line.textContent !== words) line.textContent = words;
}

function takeState(changed, fresh) {
  if (fresh) {
    starting = false;
    at("events").replaceChildren();
    ask();
    return;
  }
  if ("run" in changed) {
    starting = false;
    charts.clear();
    friction.reset();
    at("events").replaceChildren();
  }
  for (const name of ["status", "about", "record", "channels", "live", "curves", "verdict"]) {
    if ("run" in changed && !(name in changed)) state[name] = null;
  }
  Object.assign(state, changed);
  link.shown = state.run || null;
  link.own = Boolean(state.own);
  if (changed.channels) charts.use(changed.channels);
  if (changed.points) friction.take(changed.points);
  if ("curves" in changed) friction.use(changed.curves);
  if ("record" in changed) friction.weigh(changed.record?.masses || {});
  if (changed.events) addEvents(changed.events);
  for (const words of changed.notes || []) {
    starting = false;
    say(words);
  }
  if (changed.choices) start.choices(changed.choices);
  if (changed.choices || changed.about) showBenches();
  if (changed.runs || "own" in changed) showRuns();
  if (changed.scope) at("scope").textContent = changed.scope;
  showRun();
  if (changed.record || changed.live || changed.about) showTables(state, changed, valuesWhen());
  showControls();
}

function takeCharts(buffer) {
  charts.take(buffer, Number(at("window").value));
}

function ask() {
  link.want({ window_s: Number(at("window").value), pixels: charts.pixels(),
    run: at("runs").value || null });
}

function showContact(silentMs) {
  const lost = silentMs > 0;
  const before = lostMs;
  lostMs = silentMs;
  at("contact").textContent = lost ? "NO CONTACT" : link.token ? "live" : "live, read only";
  document.body.classList.toggle("stale", lost || Boolean(going() && state.live?.silent));
  if (state.run && (lost || before)) {
    showFacts();
    if (state.about) showTables(state, {}, valuesWhen());
    showControls();
  }
  const since = Number.isFinite(silentMs) ? ` for ${Math.round(silentMs / 1000)} s` : "";
  alertOnce("contact", lost
    ? `No contact with the console${since}: the values on this page are old. The run continues without this page. If STOP does not work, use the emergency stop.`
    : "", true);
}

function going() {
  return Boolean(state.run && state.status && !state.status.ended && !state.live?.gone);
}

function showRuns() {
  const select = at("runs");
  const wanted = select.value;
  const options = [new Option(state.own ? "run of this page" : "newest run", "")]
    .concat((state.runs || []).map((run) => new Option(runWords(run), run.key)));
  select.replaceChildren(...options);
  select.value = options.some((option) => option.value === wanted) ? wanted : "";
}

function runWords(run) {
  const begun = run.begun ? `, ${run.begun.slice(11, 19)} UTC` : "";
  return `${run.name} on ${run.bench}${begun}${run.over ? ", ended" : ""}`;
}

// Benches that can be made safe: first the bench of the run that is shown.
function showBenches() {
  const select = at("safe-bench");
  const { about, choices } = state;
  const shown = about ? [new Option(`${about.bench}, of the run that is shown`, about.bench_file)] : [];
  const wanted = select.value;
  const options = [...shown, ...(choices?.benches || []).map((name) => new Option(name, name))];
  select.replaceChildren(...options);
  if (options.some((option) => option.value === wanted)) select.value = wanted;
}

function showOthers() {
  const others = (state.moving || []).filter((each) => each.key !== state.run);
  const line = at("others");
  line.hidden = !others.length;
  const words = `Also in progress, not on this page: ${others.map((each) => each.name).join("; ")}. STOP stops them as well. Choose a run at the top of the page to see it.`;
  if (!line.hidden && line.textContent !== words) line.textContent = words;
}

function showRun() {
  const { about, status, live, record } = state;
  const badge = at("bench");
  showOthers();
  if ((said.run && said.run !== state.run) || (said.end && !status?.ended)) say("");
  document.body.classList.toggle("no-run", !state.run || !about);
  if (!state.run || !about) {
    badge.className = "badge";
    badge.textContent = "no run: start one below, or with `rig run`";
    for (const id of ["phase", "stage", "left", "drive"]) at(id).textContent = "-";
    at("phase-words").textContent = "";
    for (const id of ["ending", "headline", "first", "failed"]) at(id).hidden = true;
    at("resume-box").hidden = true;
    at("prompt").hidden = true;
    showJudged();
    return;
  }
  badge.className = `badge ${about.real ? "real" : "simulated"}`;
  badge.textContent = `${about.real ? "REAL" : "SIMULATED"} bench ${about.bench}`;
  document.title = `${about.name} on ${about.bench} - rig console`;
  const phase = status?.phase || "connecting";
  const over = status?.ended;
  at("phase").textContent = over ? "ended" : phase;
  at("phase-words").textContent = over ? "" : PHASES[phase] || "";
  const place = about.stages.indexOf(status?.stage) + 1;
  at("stage").textContent = status?.stage ? `${status.stage} (${place} of ${about.stages.length})` : "-";
  at("left").textContent = over ? "-" : timeWords(status?.left_s);
  showEnding();
  showFacts();
  if (going()) showActivity();
  showPrompt();
  alertOnce("silent", live?.silent
    ? "The run does not answer: its program is busy or hangs. The page names below what switches the drive's power off in this case. If in doubt, use the emergency stop." : "");
  alertOnce("gone", live?.gone
    ? "The program of the run ended without recording an end. Look at the bench: this page does not know the state of the drive. `rig recover` repairs the recording." : "");
  alertOnce("trouble", live?.trouble || "");
}

// Headline, state of the drive and values, with their age.
function showFacts() {
  const { about, status, live, record, verdict } = state;
  const when = valuesWhen();
  const age = when.endsWith("old:") ? `, ${when.replace(" old:", "")} ago` : "";
  const drive = driveWords(status, live, record);
  at("drive").textContent = age ? `was ${drive}${age}` : lostMs && going() ? `was ${drive}, last known` : drive;
  const [shown, kind] = headlineOf(going() || !status, status || {}, live, record, verdict);
  const yet = shown === "DONE, NOT JUDGED" && about?.judged ? " YET" : "";
  const words = lostMs && going() ? `${shown}${age.toUpperCase() || ", LAST KNOWN"}` : shown + yet;
  const line = at("headline");
  line.hidden = false;
  line.className = lostMs && going() ? "bad" : kind;
  if (line.textContent !== words) line.textContent = words;
  if (live?.values) charts.values(live.values, when);
}

function valuesWhen() {
  return going() ? whenWords(state.status.phase, state.live, lostMs) : "last";
}

function showList(id, rows) {
  const list = at(id);
  list.hidden = !rows.length;
  if (list.dataset.words === rows.join("\n")) return;
  list.dataset.words = rows.join("\n");
  list.replaceChildren(...rows.map((words) => {
    const line = document.createElement("li");
    line.textContent = words;
    return line;
  }));
}

function showEnding() {
  const ended = state.status?.ended;
  const open = Boolean((ended || state.live?.gone)
    && state.record?.stages.some((stage) => stage.state !== "done"));
  at("resume-box").hidden = !open;
  at("resume-real").hidden = !state.about?.real;
  const line = at("ending");
  line.hidden = !ended;
  showJudged();
  const record = state.record;
  alertOnce("unverified", ended && record?.de_energised === false
    ? "The state of the drive could NOT be verified. Switch the main supply off before you approach the bench." : "", true);
  const over = Boolean(ended || state.live?.gone);
  showList("first", (over && record?.first || []).map((words) => `First: ${words}`));
  showList("failed", (over && state.verdict?.failed || []).map((words) => `Failed: ${words}`));
  if (!ended) {
    endDue = state.status ? state.run : null;
    return;
  }
  if (stopDue.includes(state.run)) endDue = state.run;
  if (endDue !== state.run) endDue = null;
  const kind = !ended.good || state.verdict?.verdict === "rejected" ? "" : state.verdict ? " good" : " calm";
  line.className = `ending${kind}`;
  if (line.textContent !== ended.words) line.textContent = ended.words;
  if (endDue === state.run && (record?.de_energised ?? null) !== null) {
    endDue = null;
    stopDue = stopDue.filter((key) => key !== state.run);
    // Earlier messages, such as the answer to a prompt, no longer apply.
    if (!starting) {
      say(record.de_energised ? "The run has ended; the drive is off (read back)"
        : "The run has ended; the state of the drive could NOT be verified", state.run, true);
    }
  }
}

// Verdict on a run that has ended, and links to its pages, when the list of runs contains them.
function showJudged() {
  const run = state.run && state.status?.ended ? recorded.of(state.about?.folder) : null;
  const line = at("judged");
  line.hidden = !run || !run.pages.length;
  const none = !state.about?.judged ? "none, because no acceptance limits are stated"
    : state.status?.ended?.good ? "not known yet; the run is being judged" : "none; the run is judged when all stages are done";
  const known = JSON.stringify(run && [run.folder, run.verdict, run.pages, none]);
  if (line.hidden || line.dataset.known === known) return;
  line.dataset.known = known;
  line.replaceChildren(`Verdict: ${run.verdict === "-" ? none : run.verdict}. Pages: `,
    ...recorded.links(run));
}

function showPrompt() {
  const prompt = state.status?.prompt;
  const box = at("prompt");
  box.hidden = !prompt;
  if (!prompt) {
    box.dataset.number = "";
    return;
  }
  const told = (state.status.told || []).filter(([number]) => number > prompt.since)
    .slice(-TOLD).map(([, words]) => words);
  if (answered?.run === state.run && prompt.number > answered.number) {
    // A question about the same subject is asked again only if the answer was refused.
    if (prompt.since === answered.since && told.length) say(`Refused: ${told.at(-1)}`, state.run);
    answered = null;
  }
  showList("told", told);
  const weight = prompt.topic === "weight";
  at("mass-form").hidden = !weight;
  at("go-on").hidden = weight;
  at("repeat").textContent = weight ? "Repeat the stage before" : "Repeat this stage";
  // Every program counts its prompts from 1.
  const number = `${state.run} ${prompt.number}`;
  if (box.dataset.number !== number) {
    box.dataset.number = number;
    at("mass").value = "";
  }
}

function addEvents(events) {
  const list = at("events");
  for (const words of events) {
    const line = document.createElement("li");
    line.textContent = words;
    list.prepend(line);
  }
  while (list.children.length > EVENTS) list.lastChild.remove();
}

function showControls() {
  const { controls, status } = state;
  const may = Boolean(controls?.may);
  const mine = may && controls.yours;
  at("holder").textContent = !link.token ? "Read only: open the address that `rig console` printed."
    : !may ? "Read only: the token belongs to another start of the console."
      : mine ? `This page (${link.name}) holds the controls.`
        : `${controls.holder || "No page"} holds the controls; STOP works on this page as well.`;
  at("take").hidden = !may || mine;
  const on = mine && going() && !status.stopping;
  at("pause").hidden = may && !mine;
  at("pause").disabled = !on || Boolean(status?.prompt);
  const paused = going() && status.prompt?.topic === "pause";
  const asked = going() && status.pausing && !paused;
  at("pause").setAttribute("aria-pressed", String(asked));
  at("pause").textContent = paused ? "Paused" : asked ? "Cancel the requested pause"
    : "Pause at the end of the stage";
  at("resume").disabled = !mine || !state.live?.closed || starting;
  for (const id of ["mass", "go-on", "repeat", "abort"]) at(id).disabled = !on;
  if (on && status.prompt?.topic === "weight" && !state.about?.stages.indexOf(status.stage)) {
    at("repeat").disabled = true; // there is no stage before the first
  }
  at("mass-form").querySelector("button").disabled = !on;
  const stop = at("stop");
  // STOP is never off because of what this page believes: the console looks again at every press.
  stop.disabled = !link.token || Boolean(controls && !may);
  const moving = state.moving || [];
  const what = lostMs ? "no contact: what moves is not known"
    : moving.length ? `stops ${moving.map((each) => each.name).join(", ")}` : "nothing is in progress";
  if (at("stop-what").textContent !== what) at("stop-what").textContent = what;
  if (unconfirmed?.length && unconfirmed.every((key) => (state.runs || []).some((run) => run.key === key && run.ended))) {
    unconfirmed = null;
    alertOnce("stop", "");
  }
  const again = moving.length > 0 && moving.every((each) => each.stopping);
  stop.classList.toggle("again", again);
  at("stop-label").textContent = again ? "STOP again: power off at once, without the ramp" : "STOP";
  at("make-safe").disabled = stop.disabled || makingSafe;
  start.allow(mine);
}

async function pressStop() {
  const now = performance.now();
  if (at("stop").disabled || now - lastStop < AGAIN_MS) return;
  lastStop = now;
  starting = false;
  say("STOP is sent");
  const answer = await link.post("/command", { command: "stop" });
  const took = Math.round(performance.now() - now);
  unconfirmed = answer.ok ? null : answer.unconfirmed || (state.moving || []).map((each) => each.key);
  alertOnce("stop", answer.ok ? ""
    : `STOP was NOT confirmed. Use the emergency stop. (${answer.words})`, true);
  if (!answer.ok) {
    say("STOP was NOT confirmed");
    return;
  }
  const { stopped } = answer;
  stopDue = stopped;
  if (stopped.length && !stopped.includes(state.run)) {
    // The page shows the end of what was stopped.
    at("runs").value = "";
    ask();
  }
  // The end of the run may have been told meanwhile.
  if (said.end) return;
  say(stopped.length ? `STOP was accepted after ${took} ms by ${answer.words}; the state of the drive is being read back`
    : "Nothing was in progress that this console can reach", stopped.includes(state.run) ? state.run : null);
}

// A click that waited in a frozen page refers to the content that the page showed at that time.
function fresh(event) {
  const age = performance.now() - event.timeStamp;
  if (age <= FROZEN_MS) return true;
  say(`The command was not sent: this page was frozen for ${(age / 1000).toFixed(1)} s after the click. Click again if you still want the command.`);
  return false;
}

async function command(event, content, done) {
  event.preventDefault();
  if (!fresh(event)) return false;
  const run = state.run;
  const answer = await link.post("/command", { run, ...content });
  if (!answer.ok) say(failure(answer), run);
  else if (run === state.run && !state.status?.ended) say(done, run);
  return answer.ok;
}

async function answerPrompt(event, text) {
  const prompt = state.status?.prompt;
  if (!prompt) return;
  const asked = { run: state.run, number: prompt.number, since: prompt.since };
  const sent = await command(event, { command: "answer", prompt: prompt.number, text }, `Answered: ${text}`);
  if (sent) answered = asked;
}

at("stop").addEventListener("click", pressStop);
at("pause").addEventListener("click", (event) => {
  const pausing = state.status?.pausing;
  command(event, { command: pausing ? "no pause" : "pause" },
    pausing ? "The pause is cancelled" : "The run pauses at the end of this stage");
});
at("mass-form").addEventListener("submit", (event) => {
  const text = at("mass").value.trim();
  event.preventDefault();
  if (text) answerPrompt(event, text);
  else say("Type the mass that the scales show; 0 for an empty lever.");
});
for (const [id, text] of [["go-on", "go on"], ["repeat", "repeat"], ["abort", "abort"]]) {
  at(id).addEventListener("click", (event) => answerPrompt(event, text));
}
at("resume").addEventListener("click", async (event) => {
  if (!fresh(event) || starting) return;
  starting = true;
  showControls();
  const answer = await link.post("/resume", {
    run: state.run, typed_bench: at("resume-bench").value,
    operator: at("start-operator").value.trim(),
  });
  if (answer.ok) {
    at("resume-bench").value = "";
    awaitRun(answer.words);
  } else {
    starting = false;
    say(failure(answer));
    showControls();
  }
});
at("make-safe").addEventListener("click", async () => {
  const bench = at("safe-bench");
  const name = bench.selectedOptions[0].textContent;
  makingSafe = true;
  showControls();
  alertOnce("off", "");
  at("safe-words").textContent = `${name}: the power is being taken off; this takes up to half a minute.`;
  const answer = await link.post("/off", { bench: bench.value });
  makingSafe = false;
  showControls();
  const proved = answer.ok && answer.proved;
  at("safe-words").textContent = answer.words;
  alertOnce("off", proved ? "" : `${name} was NOT proved off. Switch the main supply off by hand. (${answer.words})`, true);
});
at("take").addEventListener("click", async () => {
  const answer = await link.post("/controls", {});
  say(answer.words);
});
at("runs").addEventListener("change", ask);
at("window").addEventListener("change", ask);
document.addEventListener("visibilitychange", () => charts.draw());

function isSpaceOfStop(event) {
  const typing = event.target instanceof HTMLInputElement && event.target.type === "text";
  return event.code === "Space" && !typing && !at("stop").disabled
    && Boolean(state.moving?.length || lostMs);
}
addEventListener("keydown", (event) => {
  if (!isSpaceOfStop(event)) return;
  event.preventDefault();
  if (!event.repeat) pressStop();
}, { capture: true });
// A browser clicks a focused button when the space bar is released.
addEventListener("keyup", (event) => {
  if (isSpaceOfStop(event)) event.preventDefault();
}, { capture: true });

// Content of the charts, for tests and for the browser's console.
window.rigConsole = { extremes: () => charts.extremes(), continued: () => charts.continued,
  axis: (name) => charts.axis(name) };
