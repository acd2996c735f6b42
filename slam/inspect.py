"""`slam info`: what a log holds, in a few lines."""

from __future__ import annotations

from pathlib import Path

from logs.errors import shown
from logs.mcap_log import open_log


def describe_log(path: Path) -> str:
    """Channels with counts and rates, time span, identity and attachments, as text.

    Raises:
        LogError: the log cannot be read.
    """
    first: dict[str, int] = {}
    last: dict[str, int] = {}
    with open_log(path) as log:
        for receipt_ns, message in log.receipts():
            topic = type(message).__name__
            first.setdefault(topic, receipt_ns)
            last[topic] = receipt_ns
        counts, metadata = log.counts(), log.metadata()
        attachments = [shown(a.name) for a in log.attachments()]
        skipped = dict(log.skipped)
    span_s = (max(last.values()) - min(first.values())) * 1e-9 if first else 0.0
    lines = [f"{path}: {sum(counts.values())} messages in {span_s:.1f} s"]
    for topic, count in sorted(counts.items()):
        rate = f"{(count - 1) / span_s:8.2f} Hz" if span_s > 0 and count > 1 else ""
        lines.append(f"  {shown(topic):<16} {count:>9} {rate}")
    for name, values in sorted(metadata.items()):
        told = ", ".join(f"{shown(k)} {shown(v)}" for k, v in sorted(values.items()))
        lines.append(f"  {shown(name)}: {told}")
    if attachments:
        lines.append(f"  attachments: {', '.join(attachments)}")
    lines += [f"  skipped: {count} {shown(cause)}" for cause, count in sorted(skipped.items())]
    return "\n".join(lines)
