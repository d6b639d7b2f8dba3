"""Shows stories (results of ``petmjx.tell``) in notebooks, as a page that can be played and turned."""

from __future__ import annotations

import html

from petmjx.analysis.story import Story, tell
from petmjx.show.pages.story_page import story_page

__all__ = ["story_as_html", "tell"]

FRAME_HEIGHT_PX = 760


def story_as_html(story: Story) -> str:
    """The page of a story inside an HTML frame, so that its styles do not mix with those of the notebook."""
    page, title = html.escape(story_page(story)), html.escape(repr(story))
    style = f"width: 100%; height: {FRAME_HEIGHT_PX}px; border: 0"
    return f'<iframe title="{title}" srcdoc="{page}" style="{style}"></iframe>'


Story.page = story_as_html
