// Tables sort by a click on a column's name: rows stay below their own heading, what is no number stands last.
"use strict";
(() => {
  const RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹";

  // The number that a cell begins with, as the report writes it: 1,234.5  −0.3  < 10⁻⁶  > 99 %; NaN where there is none.
  function numberIn(text) {
    const said = text.replace(/[−⁻]/g, "-").replace(/,/g, "").replace(/^[<>≤≥~\s]+/, "");
    const power = said.match(/^10(-?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)$/);
    if (power) return 10 ** Number(power[1] + [...power[2]].map((digit) => RAISED.indexOf(digit)).join(""));
    return parseFloat(said);
  }

  function compared(column, cells) {
    const told = cells.filter((text) => text && text !== "–");
    const numbers = told.every((text) => !Number.isNaN(numberIn(text)));
    return (a, b) => {
      const [first, second] = [a, b].map((row) => row.cells[column].textContent.trim());
      if (!numbers) return first.localeCompare(second, "en", { numeric: true });
      return numberIn(first) - numberIn(second);
    };
  }

  function sort(table, column, descending) {
    const bodies = [...table.tBodies].map((body) => [body, [...body.rows].filter((row) => !row.classList.contains("group"))]);
    const text = (row) => row.cells[column].textContent.trim();
    const before = compared(column, bodies.flatMap(([, rows]) => rows.map(text)));
    const unknown = (row) => text(row) === "" || text(row) === "–";
    for (const [body, rows] of bodies) {
      const known = rows.filter((row) => !unknown(row)).sort((a, b) => (descending ? before(b, a) : before(a, b)));
      body.append(...known, ...rows.filter(unknown));
    }
  }

  for (const table of document.querySelectorAll("table")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const descending = head.getAttribute("aria-sort") === "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", descending ? "descending" : "ascending");
        sort(table, column, descending);
      });
    });
  }
})();
