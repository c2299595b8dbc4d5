// Questions to the server; the token is part of the page's own address.
const BASE = new URL(".", location.href);

export class Refused extends Error {
  constructor(words, status, found = {}) {
    super(words);
    this.status = status;
    this.found = found;
  }
}

async function answered(response) {
  const text = await response.text().catch(() => "");
  let found = null;
  try {
    found = JSON.parse(text);
  } catch {
    found = {error: text};
  }
  if (!response.ok) {
    throw new Refused(found.error || `the server answered ${response.status}`, response.status, found);
  }
  return found;
}

async function asked(path, settings) {
  try {
    return await fetch(new URL(path, BASE), settings);
  } catch {
    throw new Refused(
      "the workbench does not answer: it was ended, or this page is too old; start `structid app` again. Runs go on without it",
      0,
    );
  }
}

export async function get(path, given = {}) {
  return answered(await asked(`api/${path}?${new URLSearchParams(given)}`));
}

export async function post(path, body) {
  return answered(
    await asked(`api/${path}`, {
      method: "POST",
      headers: {"content-type": "application/json"},
      body: JSON.stringify(body),
    }),
  );
}

export async function put(name, file, replace = "") {
  return answered(
    await asked(`api/file?${new URLSearchParams({name, replace})}`, {
      method: "PUT",
      headers: {"content-type": "application/octet-stream"},
      body: file,
    }),
  );
}

export const link = (path, given) => new URL(`api/${path}?${new URLSearchParams(given)}`, BASE).href;
export const view = (path) => new URL(path, BASE.origin).href;

// One page of a browser listens to the server and tells the others, which take over when it is closed: a browser opens six connections only.
// `lost` hears true where the server is away, and false when it is there again.
export function events(heard, lost) {
  const name = `structid ${BASE.href}`;
  let now = null;
  const changed = (state) => {
      now = state;
      heard(state);
    },
    away = lost;
  const listen = (tell) => {
    const source = new EventSource(new URL("api/events", BASE));
    source.onmessage = (message) => {
      const state = JSON.parse(message.data);
      tell({now: state});
      changed(state);
    };
    source.onerror = () => {
      tell({isAway: true});
      away(true);
    };
    source.onopen = () => {
      tell({isAway: false});
      away(false);
    };
  };
  if (!navigator.locks || !window.BroadcastChannel) {
    listen(() => {});
    return;
  }
  const others = new BroadcastChannel(name);
  let isListening = false;
  others.onmessage = ({data}) => {
    if (data.asks) {
      if (isListening && now) {
        others.postMessage({now});
      }
      return;
    }
    if (data.isAway !== undefined) {
      away(data.isAway);
    }
    if (data.now) {
      changed(data.now);
    }
  };
  others.postMessage({asks: true});
  navigator.locks.request(
    name,
    () =>
      new Promise(() => {
        isListening = true;
        listen((told) => others.postMessage(told));
      }),
  );
}
