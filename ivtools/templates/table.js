"use strict";
/* Sorts <table class="sortable"> by a click on a column's name, and shows the rows that hold a text. */
document.querySelectorAll("table.sortable").forEach((table) => {
  const body = table.tBodies[0], rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
  const text = (row, k) => row.cells[k].textContent.trim();
  const number = (row, k) => { const x = parseFloat(text(row, k)); return Number.isNaN(x) ? null : x; };

  function sort(k) {
    const down = heads[k].getAttribute("aria-sort") === "ascending", sign = down ? -1 : 1;
    const numeric = rows.every((row) => text(row, k) === "" || number(row, k) !== null);
    const empty = (row) => text(row, k) === "";
    const order = (a, b) => numeric ? number(a, k) - number(b, k)
      : text(a, k).localeCompare(text(b, k), undefined, { numeric: true });
    rows.sort((a, b) => empty(a) - empty(b) || sign * (empty(a) ? 0 : order(a, b))); // empty ones last
    body.append(...rows);
    heads.forEach((head, j) => j === k
      ? head.setAttribute("aria-sort", down ? "descending" : "ascending") : head.removeAttribute("aria-sort"));
  }

  heads.forEach((head, k) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    button.addEventListener("click", () => sort(k));
    head.append(button);
  });

  const tools = document.createElement("div");
  tools.className = "tools";
  tools.innerHTML = '<label>Show records with <input type="search" size="18"></label> <span role="status"></span>';
  const search = tools.querySelector("input"), status = tools.querySelector("span");
  search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) {
      const content = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => content.includes(word));
    }
    const left = rows.filter((row) => !row.hidden).length;
    status.textContent = words.length ? `${left} of ${rows.length}` : "";
  });
  table.before(tools);
});
