"""How a result is shown and stored: columns, files, figures, pages, video."""
