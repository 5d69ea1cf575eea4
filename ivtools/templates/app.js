"use strict";
/* The window of the app: sends what the user does, asks how far the work is, and puts in what changed. */
(function () {
  const WORKING = 400; // ms between questions while something is at work
  let timer = 0;

  const at = (name) => document.getElementById(name);

  async function ask(address, body, kind) {
    const options = { method: "POST", headers: { "X-Ivtools": "1" }, body };
    if (kind) options.headers["Content-Type"] = kind;
    try {
      const answer = await fetch(address, options);
      return [answer.ok, await answer.json()];
    } catch {
      return [false, { error: "The app does not answer; is it still running?" }];
    }
  }

  function fault(section, text) {
    const place = section.querySelector(".fault");
    place.textContent = text;
    place.hidden = !text;
  }

  /* Do something and show what it began; a refusal is told where it was asked for. */
  async function act(section, address, body, kind) {
    fault(section, "");
    document.body.dataset.at = "work"; // from the click on, not from the answer on
    const [good, answer] = await ask(address, body, kind);
    if (good) return show(answer);
    fault(section, answer.error);
    document.body.dataset.at = document.querySelector("[aria-busy=true]") ? "work" : "rest";
  }

  async function show(state) {
    let working = false;
    for (const [name, step] of Object.entries(state.steps)) {
      const section = at(name), busy = step.status === "working";
      working ||= busy;
      section.querySelector(".work").hidden = !busy;
      section.setAttribute("aria-busy", String(busy));
      if (busy) section.querySelector(".work p").textContent = `${step.text} … ${Math.round(step.seconds)} s`;
      const failed = step.status === "failed" || step.status === "cancelled";
      fault(section, failed ? step.text : "");
    }
    for (const button of document.querySelectorAll("main button[type=submit]")) button.disabled = working;
    await Promise.all(Object.entries(state.sections).map(refresh));
    document.body.dataset.at = working ? "work" : "rest";
    clearTimeout(timer);
    if (working) timer = setTimeout(poll, WORKING);
  }

  async function refresh([name, version]) {
    const section = at(name);
    if (section.dataset.version === version) return;
    const answer = await fetch(`section/${name}`).catch(() => null);
    if (!answer || !answer.ok) return;
    const inside = section.querySelector(".inside");
    inside.innerHTML = await answer.text();
    section.dataset.version = version;
    ivtoolsCharts.draw(inside);
  }

  async function poll() {
    const answer = await fetch("state").catch(() => null);
    if (answer && answer.ok) return show(await answer.json());
    const text = answer ? (await answer.json()).error : "The app does not answer; is it still running?";
    fault(at("log"), text);
  }

  function fields(form) {
    const found = {};
    for (const [name, value] of new FormData(form)) {
      found[name] = name === "methods" ? [...(found.methods || []), value] : value;
    }
    return JSON.stringify(found);
  }

  async function upload(what, file) {
    if (!file) return;
    const size = file.size > 5e6 ? ` (${(file.size / 1e6).toFixed(0)} MB)` : "";
    fault(at("log"), "");
    at("log").querySelector(".work").hidden = false;
    at("log").querySelector(".work p").textContent = `taking ${file.name}${size}`;
    await act(at("log"), `upload/${what}?name=${encodeURIComponent(file.name)}`, file, "application/octet-stream");
    at("log").querySelector(".work").hidden = true;
  }

  document.addEventListener("submit", (event) => {
    event.preventDefault();
    const form = event.target;
    act(form.closest(".step"), `do/${form.dataset.form}`, fields(form), "application/json");
  });
  document.addEventListener("click", (event) => {
    const button = event.target.closest("button[data-do]");
    if (button) act(button.closest(".step"), `do/${button.dataset.do}`);
  });
  document.addEventListener("change", (event) => {
    const what = event.target.dataset.upload;
    if (what) upload(what, event.target.files[0]);
  });
  for (const kind of ["dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      const zone = event.target.closest && event.target.closest("[data-drop]");
      if (kind !== "dragleave") event.preventDefault(); // a file dropped beside the zone opens nothing
      if (zone) zone.classList.toggle("over", kind === "dragover");
      if (kind === "drop" && event.dataTransfer.files.length) {
        upload(zone ? zone.dataset.drop : "log", event.dataTransfer.files[0]);
      }
    });
  }
  show(JSON.parse(at("state").textContent));
})();
