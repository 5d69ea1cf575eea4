/* What scrolls can be reached with the keyboard: code and tables that are wider than the screen. */
window.addEventListener("load", () => {
  for (const box of document.querySelectorAll("pre > code, .md-typeset__scrollwrap")) box.tabIndex = 0;
});
