// names that the theme leaves out, for those who listen to a page
document.addEventListener("DOMContentLoaded", () => {
  for (const toggle of document.querySelectorAll("summary:has(> .toctree-toggle)")) {
    const link = toggle.closest("li")?.querySelector("a");
    toggle.setAttribute("aria-label", "Pages of " + (link?.textContent.trim() ?? "this part"));
  }
  for (const button of document.querySelectorAll(".search-button-field[aria-label]")) {
    if (button.innerText.trim()) { button.removeAttribute("aria-label"); } // narrow pages show the sign alone
  }
});
