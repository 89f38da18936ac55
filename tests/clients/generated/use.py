"""Use the client that openapi-python-client generated: use.py FOLDER URL TOKEN."""

import json
import sys

sys.path.insert(0, sys.argv[1])

from stone_api_client import AuthenticatedClient
from stone_api_client.api.people import show_caller
from stone_api_client.api.sequences import create_sequence, list_sequences, show_sequence
from stone_api_client.models import NewSequenceBody, Problem, SequenceDetail

with AuthenticatedClient(base_url=sys.argv[2], token=sys.argv[3]) as client:
    caller = show_caller.sync(client=client)
    made = create_sequence.sync(client=client, body=NewSequenceBody(name="by-python"))
    assert isinstance(made, SequenceDetail), made
    page = list_sequences.sync(client=client, limit=10)
    refused = show_sequence.sync("0" * 32, client=client)
    assert isinstance(refused, Problem), refused
    names = [item.name for item in page.items]
sys.stdout.write(json.dumps({"caller": caller.name, "made": made.name, "names": names, "refused": refused.code}))
