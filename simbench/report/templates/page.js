/* Tables that sort by the column whose head is pressed; again, the other way round. */
for (const head of document.querySelectorAll("table.sortable th")) {
  head.querySelector("button").addEventListener("click", () => {
    const descending = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentElement.children) other.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const body = head.closest("table").tBodies[0], column = head.cellIndex;
    const key = (row) => row.cells[column].dataset.key;
    const rows = [...body.rows];
    const numeric = rows.every((row) => key(row) === undefined || !Number.isNaN(Number(key(row))));
    const compare = numeric ? (a, b) => a - b : (a, b) => a.localeCompare(b, "en", { numeric: true });
    rows.sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (x === undefined || y === undefined) return (x === undefined) - (y === undefined);
      return descending ? compare(y, x) : compare(x, y);
    });
    body.append(...rows);
  });
}

/* Without a clipboard (a page that is no secure context) the command is selected. */
for (const button of document.querySelectorAll("button.copy")) {
  button.addEventListener("click", async () => {
    const code = button.previousElementSibling;
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(code);
      button.textContent = "Selected";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}

const views = [...document.querySelectorAll("figure.view")].map((figure) => new View(figure));
const redraw = () => views.forEach((view) => view.draw());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

/* Paper is white, whatever the screen is. */
addEventListener("beforeprint", () => { document.documentElement.classList.add("paper"); redraw(); });
addEventListener("afterprint", () => { document.documentElement.classList.remove("paper"); redraw(); });
