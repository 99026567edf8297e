// Data: the columns that all figures and scenes share, and buttons that save what a figure or a table shows as CSV.
"use strict";
const data = (() => {
  const DIGITS = 7; // that a number of four bytes has
  const given = JSON.parse(document.querySelector("script.numbers").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

  // A column's values, row by row; null where one is not known.
  function column(number) {
    const { values, codes, floats, texts } = given[number];
    if (codes !== undefined) return Array.from(bytes(codes), (code) => values[code]);
    if (texts) return texts;
    return Array.from(new Float32Array(bytes(floats).buffer), (value) => (Number.isNaN(value) ? null : value));
  }

  function written(cell) {
    if (cell === null) return "";
    const text = typeof cell === "number" ? String(Number(cell.toPrecision(DIGITS))) : String(cell);
    return /[",\r\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
  }

  function save(file, rows) {
    const text = rows.map((row) => `${row.map(written).join(",")}\n`).join("");
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv;charset=utf-8" }));
    link.download = file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function ofFigure(numbers) {
    const columns = Object.values(numbers).map(column);
    return [Object.keys(numbers), ...(columns[0] || []).map((_, k) => columns.map((values) => values[k]))];
  }

  function ofTable(table) {
    const rows = [...table.rows].filter((row) => !row.classList.contains("group"));
    return rows.map((row) => [...row.cells].map((cell) => cell.textContent));
  }

  for (const button of document.querySelectorAll(".save")) {
    const { file, columns } = button.dataset;
    const rows = () => (columns ? ofFigure(JSON.parse(columns)) : ofTable(button.closest(".table").querySelector("table")));
    button.addEventListener("click", () => save(file, rows()));
  }
  return { column };
})();
