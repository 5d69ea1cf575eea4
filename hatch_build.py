"""Links of the README and the project's addresses, all from one address in pyproject.toml.

The README's links are relative, as a clone needs them. On a package index they must be absolute;
without an address they would lead nowhere, so there they become plain text.
"""

import re
from pathlib import Path

try:
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ImportError:  # only a build has it; the tests do without
    MetadataHookInterface = object

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?://|#)([^)]+)\)")
IMAGE = re.compile(r'<img src="(?!https?://)([^"]+)"([^>]*)>')
CAPTION = r"\n\n\*[^*]+\*\n"
INSTEAD = "*The links and the figure of this page are in README.md of the source archive.*"


def readme(text: str, address: str) -> str:
    """Return the README as an index shows it."""
    if not address:
        return re.sub(IMAGE.pattern + CAPTION, f"{INSTEAD}\n", LINK.sub(r"\2", text))
    text = LINK.sub(rf"\1[\2]({address}/blob/main/\3)", text)
    return IMAGE.sub(rf'<img src="{address}/raw/main/\1"\2>', text)


def urls(address: str) -> dict[str, str]:
    """Return the project's addresses; none is better than one that leads nowhere."""
    if not address:
        return {}
    return {
        "Source": address,
        "Issues": f"{address}/issues",
        "Changelog": f"{address}/blob/main/CHANGELOG.md",
        "Documentation": f"{address}/blob/main/docs/tutorial.md",
    }


class Addresses(MetadataHookInterface):
    """Fills in what pyproject.toml calls dynamic."""

    def update(self, metadata: dict) -> None:
        """Set the README and the addresses."""
        address = self.config["address"].rstrip("/")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, address)}
        metadata["urls"] = urls(address)
