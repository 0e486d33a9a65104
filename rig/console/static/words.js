// Descriptions of the phases of a run and of times, and its tables.

import { limitWords, shownNumber } from "./charts.js";

export const PHASES = {
  connecting: "The run connects to the bench. Nothing is energised.",
  load: "The program proves that the drive is off; then the operator hangs the weight and types its mass.",
  prepare: "The drive is off. The drive's limits are written and read back.",
  enable: "The drive is being energised.",
  "first pass": "The joint moves at low amplitude, under tighter limits.",
  "weight check": "The drive holds the joint. The measured friction is compared with the confirmed mass.",
  approach: "The joint moves to the start of the stage.",
  settle: "The drive holds the joint at the start of the stage.",
  excite: "The joint follows the planned motion.",
  hold: "The drive holds the joint at the end of the motion.",
  release: "The power of the drive is being switched off.",
  "between stages": "The drive is off, between two stages.",
  finished: "The run is finished.",
};

// Phases in which the run has verified that the drive is off.
export const OFF = ["load", "prepare", "between stages", "finished"];

// In phases without power, the run has read back that the drive is off; the last sample is older.
// The phase of the weight begins with this proof; its prompt comes after it.
export function driveWords(status, live, record) {
  const phase = status?.phase || "connecting";
  const over = status?.ended;
  if (over && (record?.drive_state || record?.de_energised)) {
    if (!record.de_energised && record.drive_state === "unknown") return "unknown, NOT verified";
    return `${[record.de_energised && "off", record.drive_state].filter(Boolean).join(": ")} (read back)`;
  }
  if (live?.gone) return "not known: the program ended";
  if (phase === "connecting") return "not read yet";
  if (!over && phase === "load" && !status.prompt) return "being checked";
  return !over && OFF.includes(phase) ? "off" : live?.drive || "-";
}

// With the drive off, no samples are taken: the values are those of the last sample. They are also
// old while the console still reads samples of the time before, while the run does not answer, and
// while the page has no contact with the console (`lostMs`, ms).
export function whenWords(phase, live, lostMs = 0) {
  if (!live?.current || OFF.includes(phase)) return "last";
  const age = (live.silent ? live.silent_s : 0) + Math.round(lostMs / 1000);
  return age > 0 || lostMs > 0 ? `${timeWords(Math.max(age, 1))} old:` : "now";
}

// What the run is doing, for the line beside STOP.
export function activityWords(status) {
  if (status.stopping) return "Stopping: the program brakes and takes the power off";
  if (status.prompt) return status.prompt.topic === "pause" ? "The run is paused; the drive is off" : "The run waits for your answer";
  return `${status.stage ? `Stage ${status.stage}. ` : ""}${PHASES[status.phase] || status.phase}`;
}

// The state of a run, to be read from across the room: words and colour.
export function headlineOf(going, status, live, record, verdict) {
  if (going) {
    if (live?.silent) return ["NO ANSWER", "bad"];
    const drive = driveWords(status, live, record);
    if (/^(off|switched on)/.test(drive)) return ["OFF", "calm"];
    if (drive.startsWith("ENERGISED")) return ["ENERGISED", "power"];
    if (drive === "being checked") return ["CHECKING", "calm"];
    return drive === "not read yet" ? ["CONNECTING", "calm"] : [drive.split(/[ :(]/)[0].toUpperCase(), "bad"];
  }
  if (verdict) return verdict.verdict === "accepted" ? ["ACCEPTED", "good"] : ["REJECTED", "bad"];
  const state = record && record.state !== "running" ? record.state.toUpperCase() : "ENDED";
  return [`${state}, NOT JUDGED`, state === "DONE" ? "calm" : "bad"];
}

export function timeWords(seconds) {
  if (seconds === null || seconds === undefined) return "-";
  const whole = Math.max(0, Math.round(seconds));
  return whole >= 60 ? `${Math.floor(whole / 60)} min ${whole % 60} s` : `${whole} s`;
}

const HELD = {
  angle: ["angle_min_rad", "angle_max_rad"],
  velocity: ["speed_rad_s"],
  torque: ["torque_N_m"],
  current: ["current_A"],
  following_error: ["following_error_rad"],
};

// Tables of the stages, the warnings and the limits of a run.

const DEG = 180 / Math.PI;

const at = (id) => document.getElementById(id);

function row(cells) {
  const line = document.createElement("tr");
  cells.forEach((words, i) => {
    const cell = document.createElement(i ? "td" : "th");
    if (!i) cell.scope = "row";
    cell.textContent = words;
    line.append(cell);
  });
  return line;
}

export function showTables(state, changed, when) {
  const { about, record, live, channels } = state;
  if (!about) return;
  at("watched-by").textContent = about.watched_by;
  if (record && changed.record) {
    at("stages").replaceChildren(...record.stages.map((stage) => row([stage.name,
      stage.load.replace("_", " "),
      stage.mass_kg === null ? "not yet" : `${stage.mass_kg} kg`, stage.state])));
    at("warnings").replaceChildren(...record.warnings.map((words) => {
      const line = document.createElement("li");
      line.textContent = words;
      return line;
    }));
  }
  const limited = (channels || []).map((channel, i) => [channel, live?.values?.[i]])
    .filter(([channel]) => channel.low !== null || channel.high !== null);
  at("limits-when").textContent = when === "now" ? "Now" : when === "last" ? "Last value" : when.replace(":", "");
  at("limits").replaceChildren(...limited.map(([channel, value]) =>
    row([channel.label, shownNumber(value, channel.unit), limitWords(channel), held(state, channel)])));
}

// Whether the drive holds a limit itself: the run writes it before each stage, and reads it back.
function held(state, channel) {
  const names = HELD[channel.name];
  if (!names) return "no";
  const had = state.record?.held || {};
  if (!names.some((name) => name in had)) return "not read yet";
  const written = state.about.written;
  if (names.some((name) => had[name] === null || !(name in written))) return "no";
  const scale = channel.unit.startsWith("deg") ? DEG : 1;
  return `yes: ${names.map((name) => shownNumber(written[name] * scale, channel.unit)).join(" to ")}`;
}
