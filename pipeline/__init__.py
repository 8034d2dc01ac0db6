"""Everything around the science: how a study is spread over machines, kept, resumed, tracked and shown."""
