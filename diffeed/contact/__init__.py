"""Which bodies are near and what they do: the sweep over pairs, its candidates, friction with a memory."""
