// Tables of the stages, the warnings and the limits of a run.

import { limitWords, shownNumber } from "./charts.js";
import { HELD } from "./words.js";

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
