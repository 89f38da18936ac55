{{/* An empty list of peers would admit all. */}}
{{- define "stone.peers" -}}
{{- if not .peers }}
{{- fail (printf "%s is empty: list the permitted NetworkPolicy peers (ipBlock, namespaceSelector, podSelector)" .name) }}
{{- end }}
{{- toYaml .peers }}
{{- end }}

{{/* The pods of some roles. */}}
{{- define "stone.roles" -}}
matchLabels:
  app.kubernetes.io/name: {{ .root.Chart.Name }}
  app.kubernetes.io/instance: {{ .root.Release.Name }}
matchExpressions:
  - { key: app.kubernetes.io/component, operator: In, values: {{ toJson .roles }} }
{{- end }}

{{/* Roles that may reach a place outside: name, roles, place (to, port). */}}
{{- define "stone.reach" }}
---
apiVersion: networking.k8s.io/v1
kind: NetworkPolicy
metadata:
  name: {{ include "stone.name" (dict "root" .root "role" .name) }}
  labels:
    {{- include "stone.labels" (dict "root" .root "role" .name) | nindent 4 }}
spec:
  podSelector:
    {{- include "stone.roles" . | nindent 4 }}
  policyTypes: [Egress]
  egress:
    - to:
        {{- include "stone.peers" (dict "peers" .place.to "name" (printf "network.%s.to" .name)) | nindent 8 }}
      ports:
        {{- range .protocols | default (list "TCP") }}
        - { protocol: {{ . }}, port: {{ $.place.port }} }
        {{- end }}
{{- end }}
