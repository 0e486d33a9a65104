// Contact with the console: state and charts arrive on a WebSocket, commands go as POST.

const KEPT = "loadrig-token";
const REPLY_MS = 4000;
const LONG_MS = 200000;
const LONG = ["/dry-run", "/off"];
const STOPS = 5; // how often a STOP is sent again whose connection broke
const RETRY_MS = 500;
const REFUSED_MS = 5000; // the console has no room for a further page
const SILENT_MS = 1500;

// A browser sends the fragment of an address to no server. The page removes it from its address.
function readToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(KEPT, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEPT) || "";
}

// Describes an answer that is not ok. A command without an answer may have arrived.
export function failure(answer) {
  return answer.unknown ? `NOT CONFIRMED, it may still be carried out: ${answer.words}`
    : `Refused: ${answer.words}`;
}

export class Link {
  constructor(onState, onCharts, onContact) {
    this.token = readToken();
    this.onState = onState;
    this.onCharts = onCharts;
    this.onContact = onContact;
    this.page = "";
    this.name = "";
    this.number = 0;
    this.wanted = {};
    this.shown = null;
    this.own = false;
    this.heard = 0;
    this.open();
    setInterval(() => this.watch(), 250);
  }

  open() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      // A page that lost its contact keeps its run, so that STOP stops the run shown before.
      socket.send(JSON.stringify({ token: this.token, shown: this.shown, own: this.own }));
      socket.send(JSON.stringify(this.wanted));
    };
    socket.onmessage = (message) => this.take(message.data);
    socket.onclose = (event) => {
      if (this.socket === socket) {
        this.page = "";
        setTimeout(() => this.open(), event.code === 1013 ? REFUSED_MS : RETRY_MS);
      }
    };
    this.socket = socket;
  }

  take(data) {
    this.heard = performance.now();
    if (typeof data !== "string") {
      this.onCharts(data);
      return;
    }
    const message = JSON.parse(data);
    if (message.hello) {
      this.page = message.hello.page;
      this.name = message.hello.name;
      this.onState({}, true);
    } else if (message.state) {
      this.onState(message.state, false);
    }
  }

  watch() {
    const silent = this.heard ? performance.now() - this.heard : Infinity;
    const closed = this.socket.readyState !== WebSocket.OPEN;
    this.onContact(closed || silent > SILENT_MS ? silent : 0);
  }

  want(view) {
    this.wanted = { ...this.wanted, ...view };
    if (this.socket.readyState === WebSocket.OPEN) {
      this.socket.send(JSON.stringify(this.wanted));
    }
  }

  // Returns {ok, words, ...}; never throws. A STOP whose connection broke is sent again: the console
  // may have closed the connection because of too many others. It keeps its number, because a
  // second STOP takes the power off without a ramp.
  async post(path, content) {
    this.number = Math.max(this.number + 1, Date.now());
    const numbered = { page: this.page, number: this.number, ...content };
    let answer = await this.postOnce(path, numbered);
    for (let again = 0; answer.broken && content.command === "stop" && again < STOPS; again += 1) {
      answer = await this.postOnce(path, numbered);
    }
    return answer;
  }

  async postOnce(path, content) {
    const waiting = new AbortController();
    const timer = setTimeout(() => waiting.abort(), LONG.includes(path) ? LONG_MS : REPLY_MS);
    try {
      const answer = await fetch(path, {
        method: "POST",
        headers: {
          "Content-Type": "application/json",
          Authorization: `Bearer ${this.token}`,
        },
        body: JSON.stringify(content),
        signal: waiting.signal,
        cache: "no-store",
        credentials: "omit",
      });
      const found = await answer.json();
      return { ...found, ok: answer.ok };
    } catch (error) {
      const broken = !waiting.signal.aborted;
      return { ok: false, broken, unknown: true, words: "the console did not answer" };
    } finally {
      clearTimeout(timer);
    }
  }
}
