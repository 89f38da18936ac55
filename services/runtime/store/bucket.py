"""Creates the S3 bucket at the first start, where the store's key may do that."""

from typing import TYPE_CHECKING, Any

from botocore.exceptions import BotoCoreError, ClientError

from services.runtime.settings import StoreSettings
from services.runtime.store.keys import StoreAwayError
from services.runtime.store.s3 import client_of

if TYPE_CHECKING:
    from types_boto3_s3 import S3Client

FORBIDDEN = {"403", "AccessDenied", "Forbidden"}
UNCONSTRAINED = "us-east-1"
"""The one region that must not be named when a bucket is made."""
ABSENT = {"404", "NoSuchBucket", "NotFound"}
EXISTING = {"BucketAlreadyOwnedByYou", "BucketAlreadyExists"}


def ensure_bucket(store: StoreSettings) -> bool:
    """Make the bucket where there is none; whether it was made. One that may not be looked at is taken to stand.

    Raises `StoreAwayError`.
    """
    client, bucket = client_of(store), store.s3_bucket
    try:
        return not _stands(client, bucket) and _made(client, store)
    except (BotoCoreError, ClientError) as error:
        raise StoreAwayError(f"{client.meta.endpoint_url}/{bucket}", str(error)) from error


def _stands(client: "S3Client", bucket: str) -> bool:
    try:
        client.head_bucket(Bucket=bucket)
    except ClientError as error:
        if _code(error) in ABSENT:
            return False
        if _code(error) not in FORBIDDEN:
            raise
    return True


def _made(client: "S3Client", store: StoreSettings) -> bool:
    place: dict[str, Any] = {"LocationConstraint": store.s3_region}
    where: dict[str, Any] = {} if store.s3_region == UNCONSTRAINED else {"CreateBucketConfiguration": place}
    try:
        client.create_bucket(Bucket=store.s3_bucket, **where)
    except ClientError as error:
        if _code(error) in EXISTING:  # somebody else was quicker
            return False
        raise
    return True


def _code(error: ClientError) -> str:
    return str(error.response.get("Error", {}).get("Code", ""))
