"use strict";
// Tables of class `sortable` are sorted by a click on a heading.

for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells],
    body = table.tBodies[0];
  const value = (row, k) => row.cells[k].textContent.trim();
  const number = text => parseFloat(text.replace(/[\s\u202f]/g, ""));
  heads.forEach((head, k) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach(other => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...body.rows];
      const numeric = rows.some(row => !isNaN(number(value(row, k))));
      rows.sort((p, q) => {
        const a = value(p, k),
          b = value(q, k);
        const x = number(a),
          y = number(b);
        if (numeric && isNaN(x) !== isNaN(y)) return isNaN(x) ? 1 : -1;
        const order = numeric && !isNaN(x) ? x - y : a.localeCompare(b);
        return up ? order : -order;
      });
      body.append(...rows);
    });
  });
}
