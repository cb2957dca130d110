"""Pages of HTML: templates, styles and what fills them."""
