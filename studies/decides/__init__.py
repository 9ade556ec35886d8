"""Which number decides between models: all visited models of sealed cases, weighed in several ways."""
