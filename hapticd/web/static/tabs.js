// The tabs of the panels, of which one is shown. Arrow keys, Home and End move between them, as in WAI-ARIA. After a reload
// the last tab is shown again.
const TAB_STORAGE_KEY = "hapticd.tab";

export function mount(app, element) {
  const tabs = [...element.querySelectorAll('[role="tab"]')];
  const panelOf = (tab) => document.getElementById(tab.getAttribute("aria-controls"));

  function show(tab) {
    for (const each of tabs) {
      each.setAttribute("aria-selected", String(each === tab));
      each.tabIndex = each === tab ? 0 : -1;
      panelOf(each).hidden = each !== tab;
    }
    sessionStorage.setItem(TAB_STORAGE_KEY, tab.id);
    app.view.dispatchEvent(new CustomEvent("tab", { detail: { panel: panelOf(tab).id } }));
  }

  element.addEventListener("click", (event) => {
    const tab = event.target.closest('[role="tab"]');
    if (tab) {
      show(tab);
    }
  });
  element.addEventListener("keydown", (event) => {
    const at = tabs.indexOf(document.activeElement);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (at >= 0 && to !== undefined) {
      const tab = tabs.at(to % tabs.length);
      event.preventDefault();
      tab.focus();
      show(tab);
    }
  });
  app.tabs = { show: (panel) => show(tabs.find((tab) => panelOf(tab).id === panel)) };
  show(tabs.find((tab) => tab.id === sessionStorage.getItem(TAB_STORAGE_KEY)) ?? tabs[0]);
}
